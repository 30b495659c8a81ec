import pytest
from service_factories import TRACK
from submission_steps import refused
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.submissions.intake import check_file_name

from competitions import FIRST, competition_of, make_competition

STAGE = competition_of(make_competition()).stage(TRACK, FIRST)
PRACTICE = competition_of(make_competition(taken_here=False)).list_stages(TRACK)[0]


@pytest.mark.parametrize(
    "name",
    [
        None,
        "",
        "submission.zip",
        "Track_1",
        "Ants-Track_1-stage1.zip",
        "Bees-Track_2-stage9-results.zip",
        "-Track_2-stage9-result",
        "x" * 100_000,
        "Ants-" * 20_000 + "result",
    ],
)
def test_other_names_are_allowed(name: str | None) -> None:
    check_file_name(name, team="Ants", stage=STAGE)


@pytest.mark.parametrize(
    "name",
    [
        "Red Ants-Track_1-stage1-result",
        "red_ants-track_1-STAGE1-Result.zip",
        "Red-Ants-Track_1-stage1-result (2).jsonl.gz",
        "Red Ants-Track_1-stage1-result-final.zip",
    ],
)
def test_a_name_in_the_challenges_form_agrees(name: str) -> None:
    check_file_name(name, team="Red Ants", stage=STAGE)


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("Bees-Track_1-stage1-result.zip", "team"),
        ("Ants-Track_2-stage1-result.zip", "track"),
        ("Ants-Track_1-stage2-result.zip", "stage"),
        ("Bees-Track_2-stage2-result.zip", "team"),
    ],
)
def test_each_part_that_differs_is_named(name: str, part: str) -> None:
    with pytest.raises(ServiceError, match=f"says the {part}") as caught:
        check_file_name(name, team="Ants", stage=STAGE)
    assert caught.value.code is ProblemCode.FILE_NAME_MISMATCH
    assert caught.value.extras == {"part": part}


def test_what_is_not_known_yet_is_not_compared() -> None:
    check_file_name("Ants-Track_3-stage2-result", team="Ants")
    check_file_name("Ants-Track_1-stage2-result", team="Ants", stage=PRACTICE)
    with refused(ProblemCode.FILE_NAME_MISMATCH):
        check_file_name("Bees-Track_3-stage2-result", team="Ants")
