"""Which keys of an observation a submitted policy of Track 2 sees, told from inside the sandbox."""

from pathlib import Path

import numpy as np
import pytest
from submissions import submission_folder
from vitac.evaluator.agent.session import PolicySession
from vitac.evaluator.episodes.episode import make_environment, open_episode
from vitac.evaluator.episodes.records import make_reading
from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest
from vitac.evaluator.tracks import load_track

TASK = load_track("track_2").tasks["fusion-insertion"]
PUBLIC = [row.name for row in TASK.observables]
# Answers how many keys it was given and how many of them it expected, and, where it was given the cloud, a point of it.
POLICY = """
import gc
import numpy as np

EXPECTED = {expected!r}

class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        kept = [thing for thing in gc.get_objects() if isinstance(thing, dict) and "depth_picture" in thing]
        hidden = "depth_picture" not in observation and bool(kept)
        cloud = observation.get("point_cloud", np.zeros((480, 640, 3)))
        return np.array([len(observation), set(observation) == set(EXPECTED), cloud.sum(), hidden], dtype=np.float64)
"""


def submission(folder: Path, expected: list[str], keys: str) -> Path:
    manifest = f"track: track_2\ntasks: [fusion-insertion]\nname: looks\n{keys}"
    return submission_folder(
        folder / "Track_2", {"policy.py": POLICY.format(expected=expected), "submission.yaml": manifest}
    )


@pytest.mark.parametrize(
    ("manifest", "expected"),
    [
        ("", PUBLIC),
        (f"observation_keys: [{', '.join(PUBLIC)}]\n", PUBLIC),
        ("observation_keys: []\n", []),
        ("observation_keys: [rgb_picture, depth_picture]\n", ["rgb_picture", "depth_picture"]),
        ("observation_keys: [point_cloud]\n", ["point_cloud"]),
    ],
    ids=["no list", "all", "none", "some", "a cloud without its depth"],
)
def test_a_policy_sees_the_keys_that_it_names_and_no_privileged_one(
    tmp_path: Path, manifest: str, expected: list[str]
) -> None:
    folder = submission(tmp_path, expected, manifest)
    reading = make_reading(TASK, load_manifest(folder).observation_keys)
    env = make_environment(TASK, None, reading.sent)
    observation, _ = env.reset(options=TASK.episodes[0].options)
    with PolicySession(folder) as session, open_episode(session, TASK, reading) as policy:
        count, as_expected, total_m, hidden = policy.act(observation).tolist()
    assert (count, bool(as_expected), bool(hidden)) == (len(expected), True, False)
    if "point_cloud" in expected:
        whole, _ = make_environment(TASK).reset(options=TASK.episodes[0].options)
        assert total_m == pytest.approx(np.float32(whole["point_cloud"].sum()), rel=1e-6)


@pytest.mark.parametrize("key", ["gt_direction", "gt_offset", "segmentation", "anything"])
def test_privileged_and_unknown_keys_are_refused_with_the_valid_ones(tmp_path: Path, key: str) -> None:
    folder = submission(tmp_path, [], f"observation_keys: [rgb_picture, {key}]\n")
    with pytest.raises(ManifestRejected, match=f"has '{key}', expected each once, out of {', '.join(PUBLIC)}"):
        load_manifest(folder)
