"""A peg that is pushed into a hole, by a force and a moment at its tip: where it slides in and where it jams.

Whitney, Quasi-static assembly of compliantly supported rigid parts (Journal of Dynamic Systems, Measurement, and
Control 104, 1982): forces F_x and F_z and a moment M at the tip of a peg of half width r that stands l deep balance
sliding contacts on the sides of a parallelogram. Inside, it slides; outside, it jams.

    two contacts, one on either side:  |M / (r F_z) - mu (1 + lambda) F_x / F_z| = lambda,   lambda = l / (2 r mu)
    contacts on one side:              |F_x / F_z| = 1 / mu
"""

from dataclasses import dataclass

import numpy as np
from block_meshes import box_surface
from contact.rigid import FreeBody, rubbing
from small_scenes import IDENTITY
from vitac.envs.fem.model.mesh import RigidBody
from vitac.envs.fem.model.settings import ArenaContactSettings

# Between both walls together and the peg [m]: little more than the reach of the barrier, so that the peg hardly tilts.
CLEARANCE_M = 2.3 * ArenaContactSettings().d_hat_m
# Loads of a tenth of a newton and more: far above what the solver leaves unbalanced.
_PULL_M_S2, _TIME_STEP_S, _IPC_STEPS = 1.0, 0.003, 200
# By how much a peg slides to rub [m]; ten times as far is a slide.
_SLIP_M = 1e-5


@dataclass(frozen=True, kw_only=True)
class PegInHole:
    """A peg of rectangular section between two walls.

    Attributes:
        radius_m: half its width [m].
        depth_m: how deep its tip stands [m].
        friction: coefficient of peg and walls.
    """

    radius_m: float = 0.01
    depth_m: float = 0.02
    friction: float = 0.3

    @property
    def slenderness(self) -> float:
        """Whitney's lambda."""
        return self.depth_m / (2 * self.radius_m * self.friction)

    def foretold_load(self, moment: float, side: float) -> float:
        """Return how many times M / (r F_z) and F_x / F_z lie on the parallelogram."""
        turning = abs(moment - self.friction * (1 + self.slenderness) * side)
        bounds = [(turning, self.slenderness), (abs(side), 1 / self.friction)]
        return min(bound / load for load, bound in bounds if load > 0)

    def jams(self, moment: float, side: float) -> bool:
        """Return whether the peg stops under M / (r F_z) and F_x / F_z, or slides ever faster.

        What moves it is an acceleration. It is judged after friction has developed, over a tenth of a millimetre.
        """
        r, height, width = self.radius_m, 1.5 * self.depth_m, 2 * self.radius_m
        peg = RigidBody(
            mesh=box_surface((2 * r, width, height), (-r, -0.5 * width, -self.depth_m), "peg"), rotation=IDENTITY,
            translation_m=np.zeros(3), material="peg",
        )  # fmt: skip
        low = r + 0.5 * CLEARANCE_M
        walls = [
            RigidBody(
                mesh=box_surface((r, 1.3 * width, 2 * self.depth_m), (x, -0.65 * width, -2 * self.depth_m), "wall"),
                rotation=IDENTITY, translation_m=np.zeros(3), material="wall", fixed=True,
            )
            for x in (-low - r, low)
        ]  # fmt: skip
        free = FreeBody(peg, walls, contact=rubbing(self.friction, ("peg", "wall")), time_step_s=_TIME_STEP_S)
        start = free.place_m
        push = _PULL_M_S2 * np.array([side, 0.0, -1.0])
        torque = _PULL_M_S2 * r * moment * np.array([0.0, 1.0, 0.0])
        torque += np.cross([0.0, 0.0, -self.depth_m] - start, push)
        turning = np.cross(12 * torque / (width**2 + height**2), free.scene._x[free._rows] - start)
        rubbing_speed_m_s = 0.0
        for _ in range(_IPC_STEPS):
            free.step(push + turning)
            way_m, speed_m_s = float(start[2] - free.place_m[2]), -float(free.velocity_m_s[2])
            if not rubbing_speed_m_s and way_m > 3 * _SLIP_M:
                rubbing_speed_m_s = speed_m_s
            elif way_m > 10 * _SLIP_M:
                return speed_m_s < rubbing_speed_m_s
        return True

    def jamming_load(self, moment: float, side: float) -> float:
        """Return how many times M / (r F_z) and F_x / F_z it begins to jam, by bisection to 0.2 %."""
        low, high = (part * self.foretold_load(moment, side) for part in (0.5, 1.7))
        while high / low > 1.002:
            between = float(np.sqrt(low * high))
            low, high = (low, between) if self.jams(moment * between, side * between) else (between, high)
        return float(np.sqrt(low * high))
