"""docs/submissions.md and docs/failures.md: what they show is accepted, and each outcome is explained."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vitac.evaluator.agent.protocol import ACTION_TYPES
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.submission.manifest import parse_manifest


@pytest.fixture(scope="module")
def manual(repository: Path) -> str:
    return (repository / "docs" / "submissions.md").read_text()


@pytest.fixture(scope="module")
def failures(repository: Path) -> str:
    return (repository / "docs" / "failures.md").read_text()


def section(manual: str, title: str) -> str:
    found = re.search(rf"^## {title}\n(.*?)(?=^## )", manual, re.DOTALL | re.MULTILINE)
    assert found is not None, title
    return found[1]


def block(manual: str, language: str) -> str:
    found = re.search(rf"```{language}\n(.*?)```", manual, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_types_of_an_action_are_those_that_are_accepted(manual: str) -> None:
    assert ACTION_TYPES in " ".join(section(manual, "The policy").split())


def test_the_manifest_shown_is_accepted(manual: str) -> None:
    manifest = parse_manifest(block(manual, "yaml").encode())
    assert (manifest.track, manifest.tasks, manifest.entry_point) == ("track_1", ("peg-insertion",), "policy:Policy")


def test_names_what_every_outcome_usually_means(failures: str) -> None:
    ends = section(failures, "How an episode ends")
    explained = set(re.findall(r"^- \*\*(\w+)\*\*: ", ends, re.MULTILINE))
    assert set(map(str, EpisodeOutcome)) - explained == {EpisodeOutcome.SUCCESS, EpisodeOutcome.ACTIONS_ENDED}


def test_the_example_answers_with_a_valid_action(manual: str) -> None:
    namespace: dict[str, Any] = {}
    exec(compile(block(manual, "python"), "docs/submissions.md", "exec"), namespace)  # noqa: S102 - our own document
    policy = namespace["Policy"]()
    policy.reset("peg-insertion")
    random = np.random.default_rng(1)
    action = policy.act(
        {
            "marker_flow": random.uniform(0, 320, (2, 2, 128, 2)).astype(np.float32),
            "relative_motion": np.zeros(4, np.float32),
        }
    )
    assert action.shape == (3,)
    assert action.dtype == np.float32
    assert np.all(np.abs(action) <= 1)
