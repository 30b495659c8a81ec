"""A quick stand-in for the peg task: no physics; the markers show where the hole is."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

MAX_STEPS = 4


class ToyPeg:
    """Solved when the offset is small; what is drawn follows from `rng_seed` alone.

    Args:
        keys: what is observed; everything by default.

    Attributes:
        resets: `rng_seed` of every episode so far.
    """

    def __init__(self, keys: Sequence[str] | None = None) -> None:
        self.resets: list[tuple[int, int]] = []
        self.keys = keys

    def reset(self, *, options: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        self.resets.append(options["rng_seed"])
        self.random = np.random.default_rng(options["rng_seed"])
        self.offset = self.random.uniform(-1, 1, 3) * [5.0, 5.0, 10.0]
        self.start, self.shape, self.steps = self.offset.copy(), int(self.random.integers(3)), 0
        return self.observation(), self.info(solved=False)

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        x, y, turn = np.clip(action, -1, 1) * [2.0, 2.0, 4.0]
        sine, cosine = np.sin(np.radians(self.offset[2])), np.cos(np.radians(self.offset[2]))
        self.offset = self.offset + np.array([cosine * x - sine * y, sine * x + cosine * y, turn])
        self.steps += 1
        solved = bool(np.abs(self.offset[:2]).max() < 2.0)
        return self.observation(), 0.0, solved, self.steps >= MAX_STEPS, self.info(solved=solved)

    @property
    def task_scene(self) -> SimpleNamespace:
        return SimpleNamespace(shape=f"shape {self.shape}", grasped=(*self.offset[:2], 0.0, 0.0, 0.0, self.offset[2]))

    def info(self, *, solved: bool) -> dict[str, Any]:
        end = "success" if solved else "steps" if self.steps >= MAX_STEPS else None
        return {"is_success": solved, "end_reason": end, "gt_offset_mm_deg": self.offset.copy()}

    def observation(self) -> dict[str, np.ndarray]:
        reference = self.random.uniform([10, 20], [310, 230], (2, 128, 2))
        reference[:, 70:] = reference[:, 69:70]
        # As the mirror image of an episode has it, x is seen along v.
        current = reference + self.offset[[1, 0]]
        observed = {
            "marker_flow": np.stack([reference, current], axis=1).astype(np.float32),
            "relative_motion": np.append(self.offset - self.start, -0.125 * self.steps).astype(np.float32),
            "shape": np.array([self.shape], dtype=np.float32),
            "gt_offset": self.offset.astype(np.float32),
            "measured_pose": np.array([*self.offset[:2], 19.875, 0, 0, self.offset[2]], dtype=np.float32),
        }
        return {key: value for key, value in observed.items() if self.keys is None or key in self.keys}
