"""Rigid bodies under gravity, on each other and on an incline."""

import numpy as np
from balance_check import Balance, BalanceCheck
from block_meshes import box_gel, box_surface
from numpy.typing import NDArray
from small_scenes import IDENTITY, driven_positions_m
from vitac.envs.fem.model.mesh import GelBody, RigidBody
from vitac.envs.fem.model.settings import AnyContactSettings
from vitac.envs.fem.scene.report import StepReport
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]
H = 0.01
GRAVITY_M_S2 = 9.81


def turned_about_y(angle_rad: float) -> FloatArray:
    """Rotation matrix."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


class Fall:
    """Rigid bodies without a gripper under a constant acceleration; a gel that touches nothing stands far away."""

    def __init__(
        self,
        bodies: list[RigidBody],
        *,
        gravity_m_s2: float = GRAVITY_M_S2,
        contact: AnyContactSettings | None = None,
        time_step_s: float = H,
    ) -> None:
        gel = GelBody(
            mesh=box_gel((0.004, 0.004, 0.004), (1, 1, 2)), rotation=IDENTITY, translation_m=np.array([1.0, 1.0, 1.0])
        )
        self.scene = Scene(gels=[gel], bodies=bodies, time_step_s=time_step_s, contact=contact)
        self._check = BalanceCheck(self.scene)
        self._targets = [driven_positions_m(gel)]
        self._gel_nodes = len(gel.mesh.rest_position_m)
        self._kick = np.array([0.0, 0.0, -gravity_m_s2 * time_step_s])
        self._fixed = [body.fixed for body in bodies]

    def step(self) -> StepReport:
        """An IPC step under gravity: with v + h g for v the predictor is x + h v + h^2 g."""
        for index, fixed in enumerate(self._fixed):
            if not fixed:
                rows = slice(self._gel_nodes + 4 * index, self._gel_nodes + 4 * index + 4)
                self.scene._velocity[rows] += self._kick
        self._check.remember()
        return self.scene.step(driven_targets_m=self._targets)

    def balance(self) -> Balance:
        """What the last IPC step has left."""
        return self._check.balance()

    def velocity_m_s(self, index: int) -> FloatArray:
        """Velocity of a body's centroid."""
        return np.asarray(self.scene._velocity[self._gel_nodes + 4 * index])

    def set_velocity(self, index: int, velocity_m_s: FloatArray) -> None:
        """Velocity of all points of a body."""
        self.scene._velocity[self._gel_nodes + 4 * index : self._gel_nodes + 4 * index + 4] = velocity_m_s


def on_incline(
    angle_rad: float, friction: float, *, contact: AnyContactSettings | None = None, time_step_s: float = H
) -> Fall:
    """A block on a plate that is turned about y, down along its x."""
    turn = turned_about_y(angle_rad)
    plate = box_surface((0.4, 0.1, 0.02), (-0.1, -0.05, -0.02), "plate")
    block = box_surface((0.02, 0.02, 0.01), (-0.01, -0.01, 0.0), "block")
    return Fall(
        [
            RigidBody(mesh=plate, rotation=turn, translation_m=np.zeros(3), friction=friction, fixed=True),
            RigidBody(mesh=block, rotation=turn, translation_m=turn @ [0, 0.001, 9e-5], friction=friction),
        ],
        contact=contact,
        time_step_s=time_step_s,
    )
