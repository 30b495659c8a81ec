"""A policy that knows the public list by heart: it works there, and gets nothing on a list derived from a secret."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from submissions import submission_folder
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.episodes.records import Observation
from vitac.evaluator.tracks import Episode, Task, load_track
from vitac.evaluator.tracks.sealed import sealed_track

POLICY = Path(__file__).parent / "policies" / "recognises_public_starts.py"
SECRET = bytes(range(32))
PLACES = (0, 90, 269)
"""Of episodes: one of each shape."""


def first_observations(task: Task, episodes: Sequence[Episode]) -> list[Observation]:
    env = make_environment(task)
    return [env.reset(options=episode.options)[0] for episode in episodes]


def fingerprint(observation: Observation) -> str:
    return hashlib.sha256(b"".join(observation[key].tobytes() for key in sorted(observation))).hexdigest()


@pytest.fixture(scope="module")
def public() -> list[Observation]:
    task = load_track("track_1").tasks["peg-insertion"]
    return first_observations(task, [task.episodes[place] for place in PLACES])


@pytest.fixture(scope="module")
def sealed() -> list[Observation]:
    task = sealed_track(load_track("track_1"), SECRET).tasks["peg-insertion"]
    return first_observations(task, [task.episodes[place] for place in PLACES])


@pytest.fixture
def folder(tmp_path: Path, public: list[Observation]) -> Path:
    """The submission, with an action of its own for each public episode."""
    folder = submission_folder(tmp_path / "Track_1")
    (folder / "policy.py").write_text(POLICY.read_text())
    table = {fingerprint(observation): answer_of(number) for number, observation in enumerate(public, start=1)}
    (folder / "known_starts.json").write_text(json.dumps(table))
    (folder / "known_starts.json").chmod(0o644)
    return folder


def answer_of(number: int) -> list[float]:
    return [number / 10, -number / 10, 0.5]


def answers(folder: Path, observations: Sequence[Observation]) -> list[list[float]]:
    def answer(session: PolicySession, observation: Observation) -> NDArray[np.float32]:
        with session.episode(task="peg-insertion", action_shape=(3,)) as policy:
            return policy.act(observation)

    with PolicySession(folder) as session:
        return [answer(session, observation).tolist() for observation in observations]


def test_public_episodes_are_recognised(folder: Path, public: list[Observation]) -> None:
    """What docs/security.md says; a board of a public list shows which kind of list it is."""
    expected = [answer_of(number) for number in range(1, len(PLACES) + 1)]
    assert np.array(answers(folder, public)) == pytest.approx(np.array(expected))


def test_episodes_of_a_list_from_a_secret_are_not(folder: Path, sealed: list[Observation]) -> None:
    assert answers(folder, sealed) == [[0.0, 0.0, 0.0]] * len(PLACES)


def test_no_first_observation_comes_twice(public: list[Observation], sealed: list[Observation]) -> None:
    seen = [fingerprint(observation) for observation in [*public, *sealed]]
    assert len(set(seen)) == 2 * len(PLACES)
