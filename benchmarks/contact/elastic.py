"""Experiments with gels: a gel on a plate, a pad that starts to slide, a sheared grip."""

from dataclasses import dataclass

import numpy as np
from block_meshes import box_gel, box_surface
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import IDENTITY, UPSIDE_DOWN, driven_positions_m
from vitac.envs.fem.contact.forces import empty_memory
from vitac.envs.fem.model.mesh import GelBody, GelMesh, RigidBody
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.tasks.settings import require

FloatArray = NDArray[np.float64]

# Of a gel and its plate at the start [m].
START_GAP_M = 9.9e-5


@dataclass(frozen=True, kw_only=True)
class Rubber:
    """Material of a gel."""

    youngs_modulus_pa: float = 3e5
    poisson_ratio: float = 0.3
    name: str = "rubber"


class OnPlate:
    """A gel whose back is driven, face down over a plate of steel at z = 0."""

    def __init__(self, mesh: GelMesh, rubber: Rubber, friction: float, *, time_step_s: float = 0.1) -> None:
        top = float(mesh.rest_position_m[:, 2].max())
        self.gel = GelBody(
            mesh=mesh, rotation=UPSIDE_DOWN, translation_m=np.array([0.0, 0.0, top + START_GAP_M]),
            youngs_modulus_pa=rubber.youngs_modulus_pa, poisson_ratio=rubber.poisson_ratio, material=rubber.name,
        )  # fmt: skip
        plate = RigidBody(
            mesh=box_surface((0.49, 0.49, 0.05), (-0.1, -0.39, -0.05), "plate"), rotation=IDENTITY,
            translation_m=np.zeros(3), material="steel", fixed=True,
        )  # fmt: skip
        pair = PairFriction(first=rubber.name, second="steel", coefficient=friction)
        self.friction, self.contact = friction, ArenaContactSettings(pair_frictions=(pair,))
        self.scene = Scene(gels=[self.gel], bodies=[plate], time_step_s=time_step_s, contact=self.contact)
        self._targets_m = driven_positions_m(self.gel)

    def move(self, by_m: FloatArray, ipc_steps: int = 1) -> None:
        """Move the back [m] in equal IPC steps."""
        for _ in range(ipc_steps):
            self._targets_m = self._targets_m + by_m / ipc_steps
            self._report = self.scene.step(driven_targets_m=[self._targets_m])
            require(
                self._report.status is not StepStatus.NOT_CONVERGED, "IPC step", self._report.status, "a solved one"
            )

    def continue_from(self, other: "OnPlate") -> None:
        """Take over where another gel of the same mesh stands, at rest and with nothing remembered of friction."""
        state = other.scene.state()
        at_rest = state._replace(velocities_m_s=np.zeros_like(state.velocities_m_s), memory=empty_memory())
        self.scene.restore(at_rest)
        self._targets_m = other._targets_m

    def force_n(self) -> FloatArray:
        """Force of the plate on the gel in the last IPC step [N], as its driven back holds it."""
        return np.array(self._report.gel_forces_n[0])

    def pressed_nodes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places [m], gaps [m] and normal forces [N] where the gel's nodes touch the plate."""
        contacts = self.scene.contact_forces()
        return contacts.points_m, contacts.gaps_m, contacts.forces_n[:, 2]

    def friction_n(self) -> FloatArray:
        """Return how much each of the `pressed_nodes` rubs [N]."""
        return np.asarray(np.sqrt((self.scene.contact_forces().forces_n[:, :2] ** 2).sum(axis=1)))


@dataclass(frozen=True, kw_only=True)
class Slid:
    """A pad that was dragged: its largest force and that in full slip over mu N, and what a minute takes of 90 %."""

    peak: float
    full: float
    relaxed: float


def slide_pad(size_m: tuple[float, float, float], rubber: Rubber, friction: float, *, time_step_s: float = 0.1) -> Slid:
    """Press a flat pad by 2 % of its thickness and drag it until it slides; hold it for a minute on the way."""
    pad = OnPlate(box_gel(size_m, (6, 6, 3), name="pad"), rubber, friction, time_step_s=time_step_s)
    pad.move(np.array([0.0, 0.0, -0.02 * size_m[2] - 5e-5]))
    relaxed, parts = 0.0, list[float]()
    while len(parts) < 6 or parts[-1] > 1.0005 * parts[-4]:
        pad.move(np.array([0.002 * size_m[2], 0.0, 0.0]))
        force_n = pad.force_n()
        part = float(-force_n[0] / (friction * force_n[2]))
        parts.append(part)
        if part > 0.9 and not relaxed:
            pad.move(np.zeros(3), round(60 / time_step_s))
            relaxed = max(1e-12, abs(float(pad.force_n()[0] / force_n[0]) - 1))
    return Slid(peak=max(parts), full=parts[-1], relaxed=relaxed)


@dataclass(frozen=True, kw_only=True)
class Sheared:
    """A sheared grip: force of the lower pad on its back [N], and how far both pads' forces are from each other."""

    force_n: FloatArray
    unbalanced: float
    asymmetry: float


def sheared_grip(
    rubber: Rubber,
    friction: float,
    *,
    cells: tuple[int, int, int] = (6, 6, 4),
    size: float = 1.0,
    halved_step: bool = False,
) -> Sheared:
    """Squeeze a box between two pads and shear them against each other until they partly slide.

    The upper pad is the lower one turned by half a turn about y, and so is its motion. All lengths are times `size`.
    """
    mesh, turn = box_gel((0.012 * size, 0.011 * size, 0.006 * size), cells), np.diag([-1.0, 1.0, -1.0])
    box = box_surface((0.06 * size, 0.06 * size, 0.01 * size), (-0.03 * size, -0.045 * size, -0.005 * size))
    at = np.array([-0.006 * size, -0.0055 * size, -0.011 * size - 5e-5])
    gels = [
        GelBody(
            mesh=mesh, rotation=r, translation_m=r @ at, material=rubber.name,
            youngs_modulus_pa=rubber.youngs_modulus_pa, poisson_ratio=rubber.poisson_ratio,
        )
        for r in (IDENTITY, turn)
    ]  # fmt: skip
    body = RigidBody(mesh=box, rotation=IDENTITY, translation_m=np.zeros(3), material="steel")
    pairs = tuple(
        PairFriction(first=rubber.name, second=other, coefficient=friction) for other in ("steel", rubber.name)
    )
    parts, time_step_s = (2, 0.05) if halved_step else (1, 0.1)
    contact = ArenaContactSettings(pair_frictions=pairs)
    scene = Scene(gels=gels, bodies=[body], time_step_s=time_step_s, contact=contact)
    targets = [driven_positions_m(gel) for gel in gels]
    for way, count in ((np.array([0.0, 0.0, 1e-4 * size]), 4), (np.array([1e-4 * size, 0.0, 0.0]), 6)):
        for _ in range(count * parts):
            targets = [target + r @ way / parts for target, r in zip(targets, (IDENTITY, turn), strict=True)]
            report = scene.step(driven_targets_m=targets)
            require(report.status is not StepStatus.NOT_CONVERGED, "IPC step", report.status, "a solved one")
    nodes = len(mesh.rest_position_m)
    forces = Probe(scene).at(scene._x).all_forces_n
    lower = forces[mesh.driven_nodes].sum(axis=0)
    upper = forces[mesh.driven_nodes + nodes].sum(axis=0)
    size = float(np.linalg.norm(lower))
    return Sheared(
        force_n=lower, unbalanced=float(np.linalg.norm(lower + upper)) / size,
        asymmetry=float(np.linalg.norm(turn @ upper - lower)) / size,
    )  # fmt: skip
