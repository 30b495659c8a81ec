"""A stand-in for ManiSkill's PickCube-v1, for tests of what plays and draws it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.envs.maniskill import env as adapter


class Tensor:
    """One environment's value with its batch dimension."""

    def __init__(self, value: Any) -> None:
        self._array = np.asarray([value])
        self.ndim = self._array.ndim

    def cpu(self) -> "Tensor":
        return self

    def numpy(self) -> np.ndarray:
        return self._array

    def __float__(self) -> float:
        return float(self._array[0])

    def __bool__(self) -> bool:
        return bool(self._array[0])


class Scene:
    """Has no body, so that all of the state is that of a controller."""

    state_dict_registry = SimpleNamespace(actors={}, articulations={})


class FakePickCube:
    """Succeeds at the third env step if told to; its state is the sum of its actions."""

    def __init__(self) -> None:
        self.single_action_space = SimpleNamespace(shape=(7,))
        self.resets: list[tuple[int, dict[str, bool]]] = []
        self.commands: list[np.ndarray] = []
        self.solves, self.fails, self.raises = False, False, False
        self.reward, self.force = 0.25, 1.0
        self.state_size = 42
        self.draws = False
        self.scene = Scene()
        self.agent = SimpleNamespace(get_controller_state=lambda: {"arm": {"targets": Tensor(self.state)}})

    def reset(self, *, seed: int, options: dict[str, bool]) -> tuple[Tensor, dict[str, Any]]:
        self.resets.append((seed, options))
        self.state, self.steps = np.full(4, seed % 100, np.float32), 0
        return self._observation(), {"elapsed_steps": Tensor(0), "reconfigure": True}

    def step(self, action: np.ndarray) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        if self.raises:
            raise ValueError("PhysX\nlost a joint")
        self.commands.append(action)
        self.steps += 1
        self.state = self.state + action.sum()
        info = {
            "success": Tensor(self.solves and self.steps == 3),
            "fail": Tensor(self.fails),
            "force": Tensor([self.force, 2.0]),
        }
        return self._observation(), Tensor(self.reward), Tensor(False), Tensor(False), info

    def get_state(self) -> Tensor:
        return Tensor(self.state)

    def _observation(self) -> Tensor:
        return Tensor(np.full(self.state_size, self.steps, np.float32))

    def render(self) -> Tensor:
        picture = np.zeros((64, 96, 3), np.uint8)
        picture[:, : 8 * (self.steps + 1)] = 200
        return Tensor(picture)


def in_place_of_maniskill(monkeypatch: pytest.MonkeyPatch) -> FakePickCube:
    """Has every environment of ManiSkill be this one, which knows whether pictures of it are wanted."""
    made = FakePickCube()

    def make(name: str, settings: Any, *, draws: bool) -> FakePickCube:
        made.draws = draws
        return made

    monkeypatch.setattr(adapter, "made", make)
    versions = {"mani-skill": "3.0.1", "sapien": "3.0.3", "torch": "2.13.0+cpu"}
    monkeypatch.setattr(adapter, "version", versions.__getitem__)
    return made
