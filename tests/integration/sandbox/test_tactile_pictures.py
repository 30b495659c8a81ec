"""A task of a track file that lists tactile pictures: a policy gets them in the sandbox, and its episodes repeat."""

import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from submissions import submission_folder
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import make_environment, resimulate, run_episode
from vitac.evaluator.episodes.records import make_reading
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import Task

PEG = load_track("track_1").tasks["peg-insertion"]
SEEING = Task.model_validate({**PEG.model_dump(), "optional_observables": ["rgb_images"]})
# Every bit of the pictures decides the action.
POLICY = """
import zlib
import numpy as np

class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        assert list(observation) == {keys!r}, list(observation)
        checksum = zlib.crc32(observation["rgb_images"].tobytes())
        return np.array([(checksum >> shift & 255) / 255.0 - 0.5 for shift in (0, 8, 16)])
"""


class SeesHere:
    """The same policy in this process."""

    cpu_s, channel_s, answers_s, output = 0.0, 0.0, (), ""

    def episode(self, **_: Any) -> "SeesHere":
        return self

    def __enter__(self) -> "SeesHere":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
        checksum = zlib.crc32(observation["rgb_images"].tobytes())
        return np.array([(checksum >> shift & 255) / 255.0 - 0.5 for shift in (0, 8, 16)])


@pytest.mark.parametrize("keys", [None, ["rgb_images"]], ids=["all", "pictures alone"])
def test_every_bit_of_the_pictures_reaches_a_policy_and_the_episode_repeats(
    tmp_path: Path, keys: list[str] | None
) -> None:
    reading, episode = make_reading(SEEING, keys), SEEING.episodes[5]
    expected = keys or ["relative_motion", "marker_flow", "rgb_images"]
    folder = submission_folder(
        tmp_path / "Track_1",
        {"policy.py": POLICY.format(keys=expected), "submission.yaml": "track: track_1\ntasks: [peg-insertion]\n"},
    )
    env = make_environment(SEEING, None, reading.sent)
    with PolicySession(folder) as session:
        record = run_episode(env=env, task=SEEING, episode=episode, open_session=lambda: session, reading=reading)
    assert record.failure is None
    here: Any = SeesHere()
    again = run_episode(env=env, task=SEEING, episode=episode, open_session=lambda: here, reading=reading)
    assert again.state_hashes == record.state_hashes
    played = resimulate(make_environment(SEEING, None, ()), episode, record.actions.to_array())
    assert list(played.state_hashes) == list(record.state_hashes)


def test_a_task_without_them_does_not_compute_them_and_has_another_digest() -> None:
    assert "rgb_images" not in {entry.name for entry in PEG.observables}
    assert "rgb_images" in {entry.name for entry in SEEING.observables}
    assert PEG.digest() != SEEING.digest()


def test_what_a_task_cannot_observe_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="no observation key 'contact_forces'; expected rgb_images"):
        Task.model_validate({**PEG.model_dump(), "optional_observables": ["contact_forces"]})
    cubes = next(iter(load_track("maniskill").tasks.values()))
    with pytest.raises(ValueError, match="no observation key 'rgb_images'; expected none"):
        Task.model_validate({**cubes.model_dump(), "optional_observables": ["rgb_images"]})
