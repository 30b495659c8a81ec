"""What other programs read in a data set."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seen_episodes import CAMERA, FPS, write_data_set
from vitac.evaluator.tracks import find_task
from vitac.training.demonstrations.frames import choose_observables
from vitac.training.demonstrations.lerobot.layout import INFO, STATS, Version, list_features

pytest.importorskip("pyarrow", reason="needs the extra `data`")

READ = """
import json, sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

found = LeRobotDataset("test/set", root=sys.argv[1], video_backend="pyav")
rows = [found[number] for number in range(len(found))]
names = [name for name in rows[0] if name not in ("task", "state_hash") and "images" not in name]
columns = {name: np.stack([row[name].numpy() for row in rows]).tolist() for name in names}
pictures = [255 * float(row["observation.images.view"].mean()) for row in rows]
texts = {name: [row[name] for row in rows] for name in ("task", "state_hash")}
print(json.dumps({"fps": found.fps, "episodes": found.num_episodes, **texts, "pictures": pictures, "columns": columns}))
"""


ACT = """
import sys
import torch
from lerobot.configs.types import FeatureType
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import make_policy, make_pre_post_processors
found = LeRobotDataset("vitac/set", root=sys.argv[1])
config = ACTConfig(device="cpu", chunk_size=2, n_action_steps=2, dim_model=32, n_heads=2, dim_feedforward=32,
                   pretrained_backbone_weights=None, push_to_hub=False)
policy = make_policy(config, ds_meta=found.meta)
before, _ = make_pre_post_processors(config, dataset_stats=found.meta.stats)
rows = LeRobotDataset("vitac/set", root=sys.argv[1], delta_timestamps={"action": [0, 1 / found.fps]})
batch = before(next(iter(torch.utils.data.DataLoader(rows, batch_size=4))))
loss, _ = policy.forward(batch)
loss.backward()
assert torch.isfinite(loss), loss
print(sorted(name for name, each in config.input_features.items() if each.type is FeatureType.ENV))
"""
"""Trains LeRobot's own ACT for a step, as `lerobot-train --policy.type=act` does."""


@pytest.mark.parametrize(
    ("task", "names"),
    [
        ("peg-insertion", [f"relative_motion_{number}" for number in range(4)]),
        ("slip", ["relative_motion", "gripper_width"]),
        ("in-hand-turn", ["goal_angle", "relative_motion_0", "relative_motion_1"]),
    ],
)
def test_the_state_joins_what_is_seen_in_numbers_and_vectors(task: str, names: list[str]) -> None:
    """LeRobot makes a scalar of a vector of one number, of which its policies then make a batch of one."""
    _, chosen = find_task(task)
    features = {feature.name: feature for feature in list_features(chosen, choose_observables(chosen, None))}
    state = features["observation.state"]
    assert (state.names, state.shape) == (names, (len(names),))
    assert [name for name, each in features.items() if name.startswith("observation.") and len(each.shape) < 2] == [
        "observation.state",
        "observation.environment_state",
    ]


@pytest.mark.slow
def test_lerobots_own_act_learns_from_the_vector_of_touch(tmp_path: Path) -> None:
    write_data_set(tmp_path / "set", Version.V3_0, with_touch=True)
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "cache")}
    command = [python_with_lerobot(Version.V3_0), "-c", ACT, str(tmp_path / "set")]
    run = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == "['observation.environment_state']"


def python_with_lerobot(version: Version) -> str:
    """Return the Python of `LEROBOT_PYTHON_V3_0` or `LEROBOT_PYTHON_V2_1`, or this one."""
    named = os.environ.get(f"LEROBOT_PYTHON_{version.name}")
    if named is None and find_spec("lerobot") is None:
        pytest.skip("lerobot is not installed, and its packages do not agree with ours; name a Python that has it")
    return named or sys.executable


@pytest.mark.slow
@pytest.mark.parametrize("version", list(Version))
def test_lerobot_reads_what_was_written(tmp_path: Path, version: Version) -> None:
    episodes = write_data_set(tmp_path / "set", version)
    command = [python_with_lerobot(version), "-c", READ, str(tmp_path / "set")]
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "cache")}
    run = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    read = json.loads(run.stdout)
    assert (read["fps"], read["episodes"], set(read["task"])) == (FPS, 3, {"Lock opening"})
    columns: dict[str, Any] = {
        "action": np.concatenate([each.actions for each in episodes]),
        "observation.flow": np.concatenate([each.observations["flow"][:-1] for each in episodes]),
        "next.reward": np.concatenate([each.rewards for each in episodes]),
        "index": np.arange(10),
    }
    for name, values in columns.items():
        np.testing.assert_array_equal(np.array(read["columns"][name], dtype=values.dtype), values)
    hashes = [state_hash for each in episodes for state_hash in each.demonstration.state_hashes[:-1]]
    assert read["state_hash"] == hashes
    assert read["pictures"] == pytest.approx(np.repeat([20, 40, 60], [3, 5, 2]), abs=3)


@pytest.mark.parametrize("version", list(Version))
def test_statistics_are_those_of_all_rows(tmp_path: Path, version: Version) -> None:
    episodes = write_data_set(tmp_path, version)
    found = json.loads((tmp_path / STATS).read_text())
    flow = np.concatenate([each.observations["flow"][:-1] for each in episodes])
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(found["observation.flow"][name], getattr(flow, name)(axis=0), atol=1e-6)
    assert found["observation.flow"]["count"] == [10]
    assert np.shape(found[CAMERA]["mean"]) == (3, 1, 1)
    assert found[CAMERA]["max"][0][0][0] == pytest.approx(60 / 255)
    assert found["next.success"]["max"] == [1.0]


def test_the_same_episodes_make_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_data_set(tmp_path / name, Version.V3_0)
    files = sorted(path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file())
    assert INFO in files
    assert len(files) == 7
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file
