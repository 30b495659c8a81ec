"""Small scenes for tests of the physics, built without the task environments."""

import numpy as np
from block_meshes import box_gel, box_surface
from numpy.typing import NDArray
from vitac.envs.fem.model.mesh import GelBody, GelMesh, RigidBody
from vitac.envs.fem.model.settings import AnyContactSettings, ArenaContactSettings, PairFriction, SolverSettings
from vitac.envs.fem.scene.report import StepReport
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]
IDENTITY = np.eye(3)
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])


def driven_positions_m(gel: GelBody) -> FloatArray:
    """Where the driven nodes of a gel stand when it is placed and undeformed [m], shape [d, 3]."""
    mesh = gel.mesh
    return mesh.rest_position_m[mesh.driven_nodes] @ gel.rotation.T + gel.translation_m


def arena_contact(friction: float) -> ArenaContactSettings:
    """The contact model arena-2 with one friction coefficient for all pairs of materials."""
    pairs = (("gel", "part"), ("part", "part"), ("gel", "gel"))
    frictions = tuple(PairFriction(first=first, second=second, coefficient=friction) for first, second in pairs)
    return ArenaContactSettings(pair_frictions=frictions)


class Grip:
    """A box of 20 x 20 x 10 mm between two gel blocks, one below and one above, that a test moves about."""

    def __init__(
        self,
        *,
        friction: float = 2.0,
        box_friction: float | None = None,
        cells: tuple[int, int, int] = (3, 3, 2),
        gel: GelMesh | None = None,
        solver: SolverSettings | None = None,
        contact: AnyContactSettings | None = None,
        gap_m: float = 5e-5,
        time_step_s: float = 0.1,
    ) -> None:
        mesh = gel or box_gel((0.012, 0.011, 0.004), cells)
        thickness = float(mesh.rest_position_m[:, 2].max())
        self.box = box_surface((0.02, 0.02, 0.01), (-0.01, -0.01, -0.005))
        low = np.array([-0.0063, -0.0052, -0.005 - thickness - gap_m])
        high = np.array([-0.0057, 0.0058, 0.005 + thickness + gap_m])
        self.gels = (
            GelBody(mesh=mesh, rotation=IDENTITY, translation_m=low, friction=friction),
            GelBody(mesh=mesh, rotation=UPSIDE_DOWN, translation_m=high, friction=friction),
        )
        self.body = RigidBody(
            mesh=self.box,
            rotation=IDENTITY,
            translation_m=np.zeros(3),
            friction=friction if box_friction is None else box_friction,
        )
        self.scene = Scene(gels=self.gels, bodies=[self.body], time_step_s=time_step_s, contact=contact, solver=solver)
        self.targets_m = [driven_positions_m(gel) for gel in self.gels]

    def move(self, lower_m: FloatArray, upper_m: FloatArray) -> StepReport:
        """One IPC step that translates the backs of both gels."""
        self.targets_m = [self.targets_m[0] + lower_m, self.targets_m[1] + upper_m]
        return self.scene.step(driven_targets_m=self.targets_m)

    def squeeze(self, closing_m: float) -> StepReport:
        """One IPC step that moves each gel towards the other."""
        return self.move(np.array([0.0, 0.0, closing_m]), np.array([0.0, 0.0, -closing_m]))
