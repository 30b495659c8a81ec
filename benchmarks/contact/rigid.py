"""Experiments with rigid parts: a block on an incline, a rod wedged between walls, a block that slides to rest."""

from dataclasses import dataclass

import numpy as np
from block_meshes import box_gel, box_surface
from numpy.typing import NDArray
from small_scenes import IDENTITY, driven_positions_m
from vitac.envs.fem.contact.barrier import barrier
from vitac.envs.fem.model.mesh import GelBody, RigidBody, SurfaceMesh
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.tasks.settings import require

FloatArray = NDArray[np.float64]
GRAVITY_M_S2 = 9.81
TOUCHING_M = 9e-5
DOWN, UP, ALONG = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class Block:
    """A prism with a regular polygon as base, of a named material.

    Attributes:
        corners: of its base.
        radius_m: of the circle around its base [m].
        height_m: [m].
        density_kg_m3: [kg/m^3].
        material: its name.
    """

    corners: int = 4
    radius_m: float = 0.014
    height_m: float = 0.01
    density_kg_m3: float = 500.0
    material: str = "wood"

    @property
    def mesh(self) -> SurfaceMesh:
        """Surface, standing on z = 0."""
        angles = 2 * np.pi * (np.arange(self.corners) + 0.5) / self.corners
        ring = self.radius_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        vertices = [[x, y, z] for z in (0.0, self.height_m) for x, y in ring]
        n, triangles = self.corners, []
        for k in range(1, n - 1):
            triangles += [[0, k + 1, k], [n, n + k, n + k + 1]]
        for k in range(n):
            following = (k + 1) % n
            triangles += [[k, following, n + k], [following, n + following, n + k]]
        return SurfaceMesh(
            vertices_m=np.array(vertices), triangles=np.array(triangles, dtype=np.int64), name=self.material
        )


class FreeBody:
    """A rigid body among fixed ones, under an acceleration; a gel that touches nothing stands far away."""

    def __init__(
        self, body: RigidBody, fixed: list[RigidBody], *, contact: ArenaContactSettings, time_step_s: float
    ) -> None:
        mesh = box_gel((0.004, 0.004, 0.004), (1, 1, 2))
        gel = GelBody(mesh=mesh, rotation=IDENTITY, translation_m=np.array([9.0, 9.0, 9.0]), material="far gel")
        self.contact, self.time_step_s, self.body = contact, time_step_s, body
        self.scene = Scene(gels=[gel], bodies=[body, *fixed], time_step_s=time_step_s, contact=contact)
        self._targets = [driven_positions_m(gel)]
        self._rows = slice(len(mesh.rest_position_m), len(mesh.rest_position_m) + 4)

    def step(self, acceleration_m_s2: FloatArray) -> None:
        """Make an IPC step, with v + h a for v: the predictor is x + h v + h^2 a; a of all or of each frame point."""
        self.scene._velocity[self._rows] += self.time_step_s * acceleration_m_s2
        report = self.scene.step(driven_targets_m=self._targets)
        require(report.status is not StepStatus.NOT_CONVERGED, "IPC step", report.status, "a solved one")

    @property
    def place_m(self) -> FloatArray:
        """Centroid [m]."""
        return np.asarray(self.scene._x[self._rows][0].copy())

    @property
    def velocity_m_s(self) -> FloatArray:
        """Velocity of the centroid [m/s]."""
        return np.asarray(self.scene._velocity[self._rows][0].copy())

    def energy_j(self, gravity_m_s2: float) -> float:
        """Energy of motion, height and barrier [J]; friction's spring is left out."""
        model = self.scene._model
        mass, velocity = model.affine.mass_kg[0], self.scene._velocity[self._rows]
        moving = 0.5 * float((velocity * (mass[:, :, None] * velocity[None]).sum(axis=1)).sum())
        contacts, stored = self.scene.contact_forces(), 0.0
        for force_n, normal, gap_m in zip(contacts.forces_n, contacts.normals, contacts.gaps_m, strict=True):
            energy, slope, _ = barrier(float(gap_m), self.contact.d_hat_m)
            stored += float(force_n @ normal) * energy / -slope
        return moving + stored + float(mass.sum()) * gravity_m_s2 * float(self.place_m[2])


def rubbing(friction: float, materials: tuple[str, str]) -> ArenaContactSettings:
    """Contact settings with one friction coefficient for two materials, and 0 for the gel far away."""
    pairs = [PairFriction(first=materials[0], second=materials[1], coefficient=friction)]
    pairs += [PairFriction(first="far gel", second=name, coefficient=0.0) for name in dict.fromkeys(materials)]
    return ArenaContactSettings(pair_frictions=tuple(pairs))


def about_y(angle_rad: float) -> FloatArray:
    """Rotation matrix."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def on_incline(block: Block, friction: float, angle_rad: float, time_step_s: float) -> tuple[FreeBody, FloatArray]:
    """Return a block on a plate of steel that is turned about y, and the direction down along it."""
    turn = about_y(angle_rad)
    plate = box_surface((0.48, 0.2, 0.05), (-0.06, -0.1, -0.05), "plate")
    free = RigidBody(
        mesh=block.mesh, rotation=turn, translation_m=turn @ [0, 0.001, TOUCHING_M],
        density_kg_m3=block.density_kg_m3, material=block.material,
    )  # fmt: skip
    fixed = RigidBody(mesh=plate, rotation=turn, translation_m=np.zeros(3), material="steel", fixed=True)
    contact = rubbing(friction, (block.material, "steel"))
    return FreeBody(free, [fixed], contact=contact, time_step_s=time_step_s), turn @ ALONG


def incline_drift_m(block: Block, friction: float, part: float, seconds: float, time_step_s: float) -> float:
    """Return how far a block drifts [m] after 0.3 s to settle, where its weight pulls by a part of the limit."""
    free, down = on_incline(block, friction, float(np.arctan(part * friction)), time_step_s)
    for _ in range(max(10, round(0.3 / time_step_s))):
        free.step(GRAVITY_M_S2 * DOWN)
    settled = free.place_m
    for _ in range(round(seconds / time_step_s)):
        free.step(GRAVITY_M_S2 * DOWN)
    return abs(float((free.place_m - settled) @ down))


def incline_acceleration_error(block: Block, friction: float, slope: float, time_step_s: float) -> float:
    """Relative error of the acceleration of a block on a slope above the friction angle."""
    angle = float(np.arctan(slope))
    free, down = on_incline(block, friction, angle, time_step_s)
    speeds, half = [], round(0.12 / time_step_s)
    for _ in range(2 * half):
        free.step(GRAVITY_M_S2 * DOWN)
        speeds.append(float(free.velocity_m_s @ down))
    expected = GRAVITY_M_S2 * (np.sin(angle) - friction * np.cos(angle))
    return float((speeds[-1] - speeds[half - 1]) / (half * time_step_s) / expected - 1)


def rigid_strain(block: Block, force_n: float, time_step_s: float) -> float:
    """Return the largest stretch, less 1, of a block on a plate that a force at its centroid presses down."""
    free, _ = on_incline(block, 0.5, 0.0, time_step_s)
    mass_kg = float(free.scene._model.affine.mass_kg[0].sum())
    for _ in range(20):
        free.step(force_n / mass_kg * DOWN)
    frame_m = free.scene._x[free._rows]
    edges = (frame_m[1:] - frame_m[0]) / free.scene._model.affine.frame_length_m[0]
    return float(np.abs(np.linalg.svd(edges, compute_uv=False) - 1).max())


def is_wedged(friction: float, steepness: float, *, gap_m: float = 0.02, time_step_s: float = 0.01) -> bool:
    """Return whether a rod stays that is pressed in between two walls, its ends touching at different heights.

    It is a thin board with a sharp edge at either end; the line through both touches rises by `steepness` over the gap.
    Both walls have been closed by 20 micrometres more than it is long, so that the barrier presses on it.
    """
    half, height = 0.5 * gap_m, 0.5 * gap_m * steepness
    squeeze = 0.5 * TOUCHING_M
    thick, wide = 0.1 * gap_m, 0.4 * gap_m
    ends = np.array([[-half + squeeze, -height], [half - squeeze, height]])
    across = np.array([-height, half]) / np.hypot(half, height)
    middle = np.array([-thick * across, thick * across])
    profile = np.array([ends[0], middle[0], ends[1], middle[1]])
    vertices = np.array([[x, y, z] for y in (-wide, wide) for x, z in profile])
    # Seen along +y the profile turns clockwise: x to the right, z up.
    triangles = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    for k in range(4):
        following = (k + 1) % 4
        triangles += [[k, k + 4, following], [following, k + 4, following + 4]]
    mesh = SurfaceMesh(vertices_m=vertices, triangles=np.array(triangles, dtype=np.int64), name="rod")
    rod = RigidBody(mesh=mesh, rotation=IDENTITY, translation_m=np.zeros(3), material="rod")
    long = 4 * gap_m * max(1.0, steepness)
    walls = [
        RigidBody(
            mesh=box_surface((gap_m, long, long), (low, -0.5 * long, -0.5 * long), "wall"),
            rotation=IDENTITY, translation_m=np.zeros(3), material="wall", fixed=True,
        )
        for low in (-half - gap_m, half)
    ]  # fmt: skip
    free = FreeBody(rod, walls, contact=rubbing(friction, ("rod", "wall")), time_step_s=time_step_s)
    ends_before = free.scene.body_vertices_m(0)[[0, 2]]
    for _ in range(100):
        free.step(np.zeros(3))
    turned = np.abs(free.scene.body_vertices_m(0)[[0, 2]] - ends_before).max()
    return bool(turned < 0.5 * free.contact.d_hat_m)


def wedging_friction(steepness: float, gap_m: float = 0.02) -> float:
    """Return the smallest friction at which a rod stays wedged, by bisection to 1 %; theory has the steepness."""
    low, high = 0.5 * steepness, 2.0 * steepness
    while high / low > 1.01:
        between = float(np.sqrt(low * high))
        low, high = (low, between) if is_wedged(between, steepness, gap_m=gap_m) else (between, high)
    return float(np.sqrt(low * high))


def largest_rise_of_energy(block: Block, friction: float, time_step_s: float) -> float:
    """Return the largest rise of the energy in an IPC step, as part of what a block thrown on a plate has."""
    free, _ = on_incline(block, friction, 0.0, time_step_s)
    free.scene._velocity[free._rows] += [0.3, 0.1, 0.0]
    start_j = energy_j = free.energy_j(GRAVITY_M_S2)
    base_j = free.energy_j(GRAVITY_M_S2) - 0.5 * float(free.scene._model.affine.mass_kg[0].sum()) * 0.1
    rises = []
    for _ in range(60):
        free.step(GRAVITY_M_S2 * DOWN)
        before_j, energy_j = energy_j, free.energy_j(GRAVITY_M_S2)
        rises.append(energy_j - before_j)
    return max(rises) / (start_j - base_j)
