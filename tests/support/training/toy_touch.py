"""An environment with the observations of a task, whose numbers follow from start and action alone."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np


class ToyTouch(gymnasium.Env[Any, Any]):
    """Random observations; an episode ends with success after a random number of env steps.

    Args:
        truths: names of the privileged observations, three numbers each.
        actions: numbers of an action; with four the clouds of Track 2 are seen, too.
    """

    def __init__(self, truths: Sequence[str], actions: int) -> None:
        self.starts: list[Any] = []
        motion = 4 if actions == 3 else 3
        clouds = {"object_point_cloud": (2, 128, 3)} if actions == 4 else {}
        shapes = {"marker_flow": (2, 2, 128, 2), "relative_motion": (motion,), **clouds, **dict.fromkeys(truths, (3,))}
        boxes: dict[str, Any] = {
            key: gymnasium.spaces.Box(-1e3, 1e3, shape, np.float32) for key, shape in shapes.items()
        }
        self.observation_space = gymnasium.spaces.Dict(boxes)
        self.action_space = gymnasium.spaces.Box(-1, 1, (actions,), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        """Begin at the start that the options name, or at the first."""
        super().reset(seed=seed)
        self.starts.append(options)
        self._random = np.random.default_rng((options or {}).get("rng_seed", (0, 0)))
        return self._observed(), {}

    def step(self, action: Any) -> Any:
        """Return a reward that follows from the action."""
        is_over = bool(self._random.random() < 0.3)
        return self._observed(), -float(np.square(action).sum()), is_over, False, {"is_success": is_over}

    def _observed(self) -> dict[str, Any]:
        boxes: Any = self.observation_space
        return {key: self._random.normal(size=box.shape).astype(np.float32) for key, box in boxes.spaces.items()}
