"""A stand-in for several scenes of ManiSkill's PickCube-v1 in one simulation, for tests of what plays a batch."""

import sys
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_pick_cube import FakePickCube, Tensor
from vitac.envs.maniskill import batch
from vitac.envs.maniskill.definition import ManiSkillSettings


class Rows(Tensor):
    """A value of each scene, along the batch dimension."""

    def __init__(self, rows: Any) -> None:
        self._array = np.array(rows)
        self.ndim = self._array.ndim

    def __getitem__(self, rows: slice) -> "Rows":
        return Rows(self._array[rows])


class FakeScenes:
    """Draws the starts of all scenes from the seed of the first, as ManiSkill does, and forgets a start that is left.

    A scene is solved where the first number of its action is 1; its state is its start and the sum of its actions.
    """

    device = "cuda"

    def __init__(self, size: int) -> None:
        self.size = size
        self.single_action_space = FakePickCube().single_action_space
        self.built: list[list[int]] = []
        self.commands: list[np.ndarray] = []
        self.raises_at: int | None = None
        self.lost_scene: int | None = None

    def reset(self, *, seed: Sequence[int], options: Mapping[str, Any]) -> tuple[Rows, dict[str, Any]]:
        assert len(seed) == self.size
        scenes = list(range(self.size))
        if options.get("reconfigure"):
            self.built.append(list(seed))
            self.state = np.zeros((self.size, 4), np.float32)
        else:
            scenes = list(options["env_idx"])
        self.steps = 0
        self.state[scenes] = np.random.default_rng(seed[0]).random((len(scenes), 4), np.float32)
        return self._observation(), {"elapsed_steps": Rows(np.zeros(self.size)), "reconfigure": True}

    def step(self, actions: np.ndarray) -> tuple[Rows, Rows, Rows, Rows, dict[str, Any]]:
        if len(self.commands) == self.raises_at:
            raise ValueError("PhysX lost the GPU")
        self.commands.append(actions.copy())
        self.steps += 1
        self.state += actions.sum(axis=1, keepdims=True)
        if self.lost_scene is not None:
            self.state[self.lost_scene] = np.nan
        ended = Rows(np.zeros(self.size, bool))
        reward = Rows(actions[:, 1])
        return self._observation(), reward, ended, ended, {"success": Rows(actions[:, 0] == 1), "fail": ended}

    def get_state(self) -> Rows:
        return Rows(self.state)

    def _observation(self) -> Rows:
        observed = np.zeros((self.size, 42), np.float32)
        observed[:, :4], observed[:, 4] = self.state, self.steps
        return Rows(observed)


def in_place_of_the_gpu(monkeypatch: pytest.MonkeyPatch) -> list[FakeScenes]:
    """Has every batch simulate with the stand-in; return those that are made."""
    simulations: list[FakeScenes] = []

    def make(name: str, settings: ManiSkillSettings, *, n_scenes: int) -> FakeScenes:
        assert (name, settings.sim_backend, settings.batch_size) == ("PickCube-v1", "physx_cuda", n_scenes)
        simulations.append(FakeScenes(n_scenes))
        return simulations[-1]

    monkeypatch.setattr(batch, "made", make)
    monkeypatch.setattr("vitac.envs.maniskill.env.version", lambda package: "1")
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(tensor=lambda values, device: values))
    return simulations
