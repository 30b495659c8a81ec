"""A quick stand-in for the lock task: no physics; the handle rotates while the teeth are under the ceiling."""

from typing import Any

import numpy as np

LIFT_TO_OPEN = 4
MARKERS, FILLING = 16, 4


class ToyLock:
    """Solved when the key was lifted in its slots; pressed too long under the ceiling, the episode ends.

    Attributes:
        resets: `rng_seed` of every episode so far.
    """

    def __init__(self) -> None:
        self.resets: list[tuple[int, int]] = []

    def reset(self, *, options: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        self.resets.append(options["rng_seed"])
        self.left_mm = float(np.random.default_rng(options["rng_seed"]).uniform(0, 5))
        self.lifted, self.pressed = 0.0, 0
        return self.observation(), {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        inwards, down = np.clip(action, -1, 1) * [2.0, 1.0]
        self.left_mm += inwards
        if abs(self.left_mm) < 2.0:
            self.lifted -= down
        else:
            self.pressed += 1
        solved = self.lifted >= LIFT_TO_OPEN - 1e-6
        return self.observation(), 0.0, bool(solved), self.pressed > LIFT_TO_OPEN, {"is_success": bool(solved)}

    def observation(self) -> dict[str, np.ndarray]:
        turn = 0.012 if abs(self.left_mm) >= 2.0 else 0.0
        return {"marker_flow": turned_flow(turn)}


def turned_flow(turn_rad: float, inwards_px: float = 0.0, up_px: float = 0.0, outwards_px: float = 0.0) -> np.ndarray:
    """Return markers of both gels, moved and turned with the handle, shape [2, 2, MARKERS + FILLING, 2].

    Args:
        turn_rad: of the handle, its tip downwards.
        inwards_px: shift of both gels' markers into the lock.
        up_px: shift upwards.
        outwards_px: shift of the left gel's markers to the left and of the right one's to the right.
    """
    u, v = np.meshgrid(np.linspace(20, 300, 4), np.linspace(20, 220, 4))
    grid = np.column_stack([u.ravel(), v.ravel()])
    grid = np.concatenate([grid, np.repeat(grid[-1:], FILLING, axis=0)])
    centre = grid[:MARKERS].mean(axis=0)
    sides = []
    for side in (-1.0, 1.0):
        angle = side * turn_rad
        place = grid - centre
        now = centre + place + angle * np.column_stack([-place[:, 1], place[:, 0]])
        sides.append(np.stack([grid, now + np.array([inwards_px + side * outwards_px, -side * up_px])]))
    return np.stack(sides).astype(np.float32)
