"""Why an environment cannot be a task, as the catalogue says it."""

import pytest
from vitac.envs.maniskill.definition import catalogue
from vitac.envs.maniskill.describing import _reason

KINDS = (
    "It needs files that ManiSkill downloads",
    "Its info has no success.",
    "It has several robots with an action each.",
    "It cannot be made: ",
)


@pytest.mark.parametrize(
    ("printed", "reason"),
    [
        ("x\nFileNotFoundError: /home/a/.maniskill/data/robots/h1.urdf", "It needs files that ManiSkill downloads."),
        ("use `python -m mani_skill.utils.download_asset x`", "It needs files that ManiSkill downloads."),
        (
            "Traceback\nImportError: svgpathtools is not installed.\n",
            "It cannot be made: ImportError: svgpathtools is n",
        ),
        ("NotImplementedError: Unsupported obs mode: rgb. Must be one of ['none', 's", "Unsupported obs mode: rgb."),
        ("", "It cannot be made: its process was ended."),
    ],
)
def test_the_reason_is_the_first_sentence_of_the_last_line(printed: str, reason: str) -> None:
    assert reason in _reason(printed)
    assert _reason(printed).endswith(".")
    assert ".." not in _reason(printed)


def test_every_refused_environment_was_tried_and_has_a_reason_of_its_own() -> None:
    refused = catalogue().refused
    assert {env_id for env_id, reason in refused.items() if not reason.startswith(KINDS)} == set()
    assert not set(refused) & set(catalogue().environments)
