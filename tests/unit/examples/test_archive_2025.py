"""An archive in the layout of 2025, whose models are played by their own code."""

import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed")
stable_baselines3 = pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed")

POLICIES = '''
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.td3.policies import Actor, TD3Policy


class Truth(BaseFeaturesExtractor):
    """What only the critics see."""

    def __init__(self, observation_space):
        super().__init__(observation_space, features_dim=3)

    def forward(self, observations):
        return observations["gt_offset"]


class OwnActor(Actor):
    """Begins with the markers and adds the batch itself."""

    def __init__(self, *arguments, width, **named):
        super().__init__(*arguments, **named)
        self.layers = torch.nn.Sequential(torch.nn.Linear(8, width), torch.nn.Linear(width, 3), torch.nn.Tanh())

    def forward(self, observations):
        return self.layers(observations["marker_flow"].flatten().unsqueeze(0))


class OwnPolicy(TD3Policy):
    def __init__(self, *arguments, width=2, **named):
        self.width = width
        super().__init__(*arguments, **named)

    def make_actor(self, features_extractor=None):
        return OwnActor(**self._update_features_extractor(self.actor_kwargs, features_extractor), width=self.width)
'''


@pytest.fixture
def archive(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Its folder, first in the path of imports as in the sandbox."""
    (tmp_path / "solutions").mkdir()
    (tmp_path / "solutions" / "policies.py").write_text(POLICIES)
    shutil.copy(repository / "examples" / "archive_2025" / "policy.py", tmp_path)
    entry = {"model": "OwnPolicy", "weights": "best.zip"}
    (tmp_path / "adapter.json").write_text(json.dumps({"peg-insertion": entry}))
    monkeypatch.syspath_prepend(str(tmp_path))
    threads = torch.get_num_threads()
    yield tmp_path
    torch.set_num_threads(threads)
    for name in [name for name in sys.modules if name.partition(".")[0] == "solutions"]:
        del sys.modules[name]


def save_model(path: Path) -> Any:
    """Write a model with arguments of its own, and return its policy."""
    from gymnasium import Env, spaces
    from solutions.policies import OwnPolicy, Truth  # type: ignore[import-not-found]

    class Nowhere(Env[Any, Any]):
        observation_space = spaces.Dict(
            {key: spaces.Box(-1e3, 1e3, shape) for key, shape in (("gt_offset", (3,)), ("marker_flow", (2, 2, 1, 2)))}
        )
        action_space = spaces.Box(-1, 1, (3,))

    arguments = {"width": 5, "features_extractor_class": Truth}
    model = stable_baselines3.TD3(
        OwnPolicy, Nowhere(), policy_kwargs=arguments, buffer_size=1, learning_rate=lambda left: 3e-4 * left
    )
    model.save(path)
    return model.policy


def test_model_acts_as_when_it_was_saved(archive: Path) -> None:
    saved = save_model(archive / "best.zip")
    policy = run_path(str(archive / "policy.py"))["Policy"]()
    policy.reset("peg-insertion")
    flow = np.random.default_rng(0).uniform(0, 1, (2, 2, 1, 2)).astype(np.float32)
    with torch.no_grad():
        expected = saved({"marker_flow": torch.from_numpy(flow)}).numpy()[0]
    found = policy.act({"marker_flow": flow})
    np.testing.assert_array_equal(found, expected)
    assert found.shape == (3,)
    with pytest.raises(ValueError, match="names no model for lock-opening, only for peg-insertion"):
        policy.reset("lock-opening")
