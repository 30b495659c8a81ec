"""Experiments with gels: a dome on a plate (Hertz, Cattaneo, Mindlin), a pad that starts to slide, a sheared grip."""

from dataclasses import dataclass

import numpy as np
from block_meshes import box_gel, box_surface
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import IDENTITY, UPSIDE_DOWN, driven_positions_m
from vitac.envs.fem.contact.barrier import barrier
from vitac.envs.fem.contact.distance import closest_points
from vitac.envs.fem.contact.friction import slip_factor
from vitac.envs.fem.model.bodies import GelBody, RigidBody
from vitac.envs.fem.model.mesh import GelMesh
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction
from vitac.envs.fem.scene.scene import Scene, StepStatus
from vitac.envs.tasks.settings import require

FloatArray = NDArray[np.float64]


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
            mesh=mesh, rotation=UPSIDE_DOWN, translation_m=np.array([0.0, 0.0, top + 9.9e-5]),
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
            report = self.scene.step(driven_targets_m=[self._targets_m])
            require(report.status is not StepStatus.NOT_CONVERGED, "IPC step", report.status, "a solved one")

    def force_n(self) -> FloatArray:
        """Force of the plate on the gel [N], as its driven back holds it."""
        driven = self.gel.mesh.driven_nodes
        return -np.asarray(Probe(self.scene).at(self.scene._x).all_forces_n[driven].sum(axis=0))

    def pressed_nodes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places [m], gaps [m] and normal forces [N] of the pairs of a gel's node and the plate that touch."""
        probe, d_hat = Probe(self.scene), self.contact.d_hat_m
        points, near = probe.points_m(self.scene._x), probe.candidates(self.scene._x, d_hat)
        place, gap, force = [], [], []
        for pair_type, corners in zip(near.pair_type, near.points, strict=True):
            d = float(np.linalg.norm(closest_points(pair_type, *map(tuple, points[corners]))[2]))
            if d < d_hat:
                place.append(points[corners[0]])
                gap.append(d)
                force.append(-self.contact.barrier_stiffness_n_m * barrier(d, d_hat)[1])
        return np.array(place), np.array(gap), np.array(force)

    def friction_parts(self) -> FloatArray:
        """Return by how much of mu N each of the `pressed_nodes` rubs."""
        slips_m = np.sqrt((self.scene._memory.slip_m**2).sum(axis=1))
        s = self.contact.elastic_slip_m
        names = (tuple(name) for name in self.scene._memory.pairs[:, :5].tolist())
        parts = {name: y * slip_factor(y, s)[0] for name, y in zip(names, slips_m.tolist(), strict=True)}
        near = Probe(self.scene).candidates(self.scene._x, self.contact.d_hat_m)
        listed = (
            (int(pair_type), *corners.tolist()) for pair_type, corners in zip(near.pair_type, near.points, strict=True)
        )
        return np.array([parts[name] for name in listed if name in parts])


def graded(inner: float, outer: float, cells: int, more: int) -> FloatArray:
    """Coordinates from -outer to outer: equal cells within the inner part, growing ones outside."""
    size, low, high = 2 * inner / cells, 1.0, 4.0
    for _ in range(60):
        ratio = 0.5 * (low + high)
        reach = size * sum(ratio**k for k in range(1, more + 1))
        low, high = (ratio, high) if reach < outer - inner else (low, ratio)
    far = inner + np.cumsum(size * low ** np.arange(1, more + 1))
    return np.concatenate([-far[::-1], np.linspace(-inner, inner, cells + 1), far])


@dataclass(frozen=True, kw_only=True)
class Dome:
    """A block with a spherical face, refined where it touches.

    Attributes:
        radius_m: of the face [m].
        touching_m: radius of the contact that it is refined for [m].
        thickness_m: [m].
        half_width_m: [m].
        cells: across the contact.
    """

    radius_m: float = 0.8
    touching_m: float = 0.04
    thickness_m: float = 0.2
    half_width_m: float = 0.2
    cells: int = 14

    @property
    def mesh(self) -> GelMesh:
        """Mesh, its face at the top, centred."""
        along = graded(1.15 * self.touching_m, self.half_width_m, round(1.15 * self.cells), 5)
        size, ratio, heights = 2 * self.touching_m / self.cells, 1.0, [0.0]
        while heights[-1] < self.thickness_m:
            heights.append(heights[-1] + size * ratio)
            ratio = ratio * 1.3 if heights[-1] > 0.4 * self.touching_m else ratio
        z = self.thickness_m * (1 - np.array(heights) / heights[-1])[::-1]
        grid = box_gel((0.1, 0.1, 0.1), (len(along) - 1, len(along) - 1, len(z) - 1))
        index = np.rint(10 * grid.rest_position_m * [len(along) - 1, len(along) - 1, len(z) - 1]).astype(int)
        x, y, height = along[index[:, 0]], along[index[:, 1]], z[index[:, 2]]
        sagging = np.minimum(x**2 + y**2, (3 * self.touching_m) ** 2) / (2 * self.radius_m)
        height = height - sagging * (height / self.thickness_m)
        position = np.ascontiguousarray(np.stack([x, y, height], axis=1))
        return GelMesh(
            rest_position_m=position, tetrahedra=grid.tetrahedra, driven=grid.driven, sensing=grid.sensing, name="dome"
        )


def hertz_force_n(dome: Dome, rubber: Rubber, depth_m: float) -> float:
    """Force that presses a ball into a layer on a stiff ground (Dimitriadis et al., Biophysical Journal 82, 2002)."""
    nu = rubber.poisson_ratio
    chi = np.sqrt(dome.radius_m * depth_m) / dome.thickness_m
    alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu)
    beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    layer = 1 - 2 * alpha / np.pi * chi + 4 * alpha**2 / np.pi**2 * chi**2
    layer -= 8 / np.pi**3 * (alpha**3 + 4 * np.pi**2 / 15 * beta) * chi**3
    layer += 16 * alpha / np.pi**4 * (alpha**3 + 3 * np.pi**2 / 5 * beta) * chi**4
    half_space = 4 * rubber.youngs_modulus_pa / (3 * (1 - nu**2)) * np.sqrt(dome.radius_m) * depth_m**1.5
    return float(half_space * layer)


def hertz_radius_m(dome: Dome, rubber: Rubber, force_n: float) -> float:
    """Contact radius under a force [m]: a^3 = 3 F R (1 - nu^2) / (4 E)."""
    return float(
        (3 * force_n * dome.radius_m * (1 - rubber.poisson_ratio**2) / (4 * rubber.youngs_modulus_pa)) ** (1 / 3)
    )


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """A dome that was pressed on the plate, measured and foretold."""

    scene: OnPlate
    force_n: float
    hertz_force_n: float
    radius_m: float
    hertz_radius_m: float
    gap_m: float


def press_dome(dome: Dome, rubber: Rubber, friction: float = 0.0, ipc_steps: int = 2) -> Pressed:
    """Press a dome so far that it touches over about `touching_m`, and compare force and radius with Hertz.

    The depth is the way of the back less what the gap in the middle shrank; the radius is that of the pressure's
    second moment, 2/5 a^2 for Hertz' pressure.
    """
    scene, depth_m = OnPlate(dome.mesh, rubber, friction), dome.touching_m**2 / dome.radius_m
    scene.move(np.array([0.0, 0.0, -depth_m]), ipc_steps)
    place, gap, force = scene.pressed_nodes()
    squared = place[:, 0] ** 2 + place[:, 1] ** 2
    middle = float(gap[np.argmin(squared)])
    total_n = float(scene.force_n()[2])
    return Pressed(
        scene=scene, force_n=total_n, hertz_force_n=hertz_force_n(dome, rubber, depth_m - 9.9e-5 + middle),
        radius_m=float(np.sqrt(2.5 * (squared * force).sum() / force.sum())),
        hertz_radius_m=hertz_radius_m(dome, rubber, total_n), gap_m=middle,
    )  # fmt: skip


def partial_slip(pressed: Pressed, rubber: Rubber, *, friction: float, part: float) -> tuple[float, float]:
    """Stick radius by contact radius under a tangential force of about a part of mu N: measured, and Mindlin's.

    A scene of the same nodes with friction starts from the dome that was pressed without, as the theory does, and its
    back is dragged until the force is there. The radius follows from the second moment of the friction,
    2/5 mu N (a^2 - c^5 / a^3) for Cattaneo's traction; theory has c^3 = a^3 (1 - Q / mu N).
    """
    scene = OnPlate(pressed.scene.gel.mesh, rubber, friction)
    scene.scene.restore(pressed.scene.scene.state())
    scene._targets_m = pressed.scene._targets_m
    limit_n = friction * pressed.force_n
    nu = rubber.poisson_ratio
    stiffness_n_m = 4 * pressed.radius_m * rubber.youngs_modulus_pa / ((1 + nu) * (2 - nu))
    while -scene.force_n()[0] < part * limit_n:
        scene.move(np.array([0.1 * limit_n / stiffness_n_m, 0.0, 0.0]))
    place, _, normal_n = scene.pressed_nodes()
    rubbed_n = friction * normal_n * scene.friction_parts()
    a2 = 2.5 * ((place[:, 0] ** 2 + place[:, 1] ** 2) * normal_n).sum() / normal_n.sum()
    second = ((place[:, 0] ** 2 + place[:, 1] ** 2) * rubbed_n).sum() / rubbed_n.sum()
    ratio = np.linspace(1e-3, 1 - 1e-6, 100_000)
    moments = 0.4 * (1 - ratio**5) / (1 - ratio**3)
    measured = float(ratio[np.argmin(np.abs(moments - second / a2))])
    load = -scene.force_n()[0] / (friction * normal_n.sum())
    return measured, float((1 - load) ** (1 / 3))


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
    rubber: Rubber, friction: float, *, cells: tuple[int, int, int] = (6, 6, 4), halved_step: bool = False
) -> Sheared:
    """Squeeze a box between two pads and shear them against each other until they partly slide.

    The upper pad is the lower one turned by half a turn about y, and so is its motion.
    """
    mesh, turn = box_gel((0.012, 0.011, 0.006), cells), np.diag([-1.0, 1.0, -1.0])
    box = box_surface((0.06, 0.06, 0.01), (-0.03, -0.045, -0.005))
    at, properties = np.array([-0.006, -0.0055, -0.01105]), {
        "youngs_modulus_pa": rubber.youngs_modulus_pa, "poisson_ratio": rubber.poisson_ratio,
    }  # fmt: skip
    gels = [
        GelBody(mesh=mesh, rotation=r, translation_m=r @ at, material=rubber.name, **properties)
        for r in (IDENTITY, turn)
    ]
    body = RigidBody(mesh=box, rotation=IDENTITY, translation_m=np.zeros(3), material="steel")
    pairs = tuple(
        PairFriction(first=rubber.name, second=other, coefficient=friction) for other in ("steel", rubber.name)
    )
    parts, time_step_s = (2, 0.05) if halved_step else (1, 0.1)
    contact = ArenaContactSettings(pair_frictions=pairs)
    scene = Scene(gels=gels, bodies=[body], time_step_s=time_step_s, contact=contact)
    targets = [driven_positions_m(gel) for gel in gels]
    for way, count in ((np.array([0.0, 0.0, 1e-4]), 4), (np.array([1e-4, 0.0, 0.0]), 6)):
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
