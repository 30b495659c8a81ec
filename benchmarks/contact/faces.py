"""Experiments on flat faces, with what is drawn from a seed: a pressed corner, a thrown block, a cycle of loads."""

from dataclasses import dataclass

import numpy as np
from block_meshes import box_surface
from contact.rigid import GRAVITY_M_S2, TOUCHING_M, FreeBody, rubbing
from numpy.typing import NDArray
from scipy.spatial import Delaunay
from small_scenes import IDENTITY
from vitac.envs.fem.contact.barrier import barrier
from vitac.envs.fem.contact.forces import pair_forces
from vitac.envs.fem.model.mesh import RigidBody, SurfaceMesh
from vitac.envs.fem.model.settings import ArenaContactSettings
from vitac.envs.fem.solver.iterate import find_contacts, remember_step

FloatArray = NDArray[np.float64]
# Half the width of a plate [m].
_HALF_M = 0.03


def drawn_plate(rng: np.random.Generator, inner: int) -> SurfaceMesh:
    """Return a plate whose top, at z = 0, and bottom are triangulated through a number of points drawn inside."""
    ring = _HALF_M * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    flat = np.concatenate([ring, rng.uniform(-0.95 * _HALF_M, 0.95 * _HALF_M, (inner, 2))])
    faces = Delaunay(flat).simplices.astype(np.int64)
    first, second = flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]]
    clockwise = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    faces[clockwise] = faces[clockwise][:, ::-1]
    n = len(flat)
    sides = [t for i in range(4) for t in ([i, n + i, (i + 1) % 4], [(i + 1) % 4, n + i, n + (i + 1) % 4])]
    vertices = np.concatenate([np.insert(flat, 2, z, axis=1) for z in (0.0, -0.02)])
    triangles = np.concatenate([faces, n + faces[:, ::-1], np.array(sides, dtype=np.int64)])
    return SurfaceMesh(vertices_m=vertices, triangles=triangles, name="plate")


def drawn_rotation(rng: np.random.Generator) -> FloatArray:
    """Return a rotation matrix, uniformly distributed (Shoemake 1992)."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.sqrt((q**2).sum())
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """A corner at a gap over a plate: lateral by normal force; normal force by that of the box's corners, less 1."""

    lateral: float
    excess: float


def press_corner(rng: np.random.Generator, force_n: float) -> Pressed:
    """Hold the lowest corner of a turned box over a drawn plate, on, beside or off its edges, where it takes a force.

    Nothing rubs, so that all lateral force is of the barrier.
    """
    plate, turn = drawn_plate(rng, int(rng.integers(1, 12))), drawn_rotation(rng)
    box = box_surface((0.01, 0.013, 0.008), (-0.005, -0.0065, -0.004))
    corners = (turn[None] * box.vertices_m[:, None, :]).sum(axis=2)
    lowest = corners[corners[:, 2].argmin()]
    # So far from the rim that no edge of the box goes over it.
    place = np.full(2, np.inf)
    while np.abs(place).max() > 0.4 * _HALF_M:
        ends = plate.vertices_m[plate.edges[rng.integers(len(plate.edges))]]
        place = (ends[0] + rng.uniform() * (ends[1] - ends[0]))[:2] + rng.choice([0, 1e-6, 5e-5, 3e-4]) * rng.normal(
            size=2
        )
    contact = rubbing(0.0, ("box", "plate"))
    gap_m = _gap_m(contact, force_n)
    body = RigidBody(mesh=box, rotation=turn, translation_m=np.array([*place, gap_m]) - lowest, material="box")
    fixed = RigidBody(mesh=plate, rotation=IDENTITY, translation_m=np.zeros(3), material="plate", fixed=True)
    scene = FreeBody(body, [fixed], contact=contact, time_step_s=0.1).scene
    total_n = pair_forces(scene._model, scene._x, scene._x, scene._memory).forces_n.sum(axis=0)
    heights = corners[:, 2] - lowest[2] + gap_m
    expected_n = sum(_barrier_n(contact, float(height)) for height in heights if height < contact.d_hat_m)
    return Pressed(lateral=float(np.hypot(*total_n[:2]) / total_n[2]), excess=float(total_n[2] / expected_n - 1))


def _barrier_n(contact: ArenaContactSettings, gap_m: float) -> float:
    return -contact.barrier_stiffness_n_m * barrier(gap_m, contact.d_hat_m)[1]


def _gap_m(contact: ArenaContactSettings, force_n: float) -> float:
    """Return the gap at which one barrier presses with a force, by bisection."""
    low, high = 0.0, contact.d_hat_m
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _barrier_n(contact, middle) > force_n else (low, middle)
    return high


def change_of_velocity(rng: np.random.Generator, speed_m_s: float) -> float:
    """Return by how much a block's velocity changes that is thrown over a drawn plate without friction, over it."""
    plate, turn = drawn_plate(rng, int(rng.integers(1, 12))), _about_z(float(rng.uniform(0, 2 * np.pi)))
    box = box_surface((0.01, 0.012, 0.008), (-0.005, -0.006, 0.0))
    start = np.array([-0.012, rng.uniform(-0.01, 0.01), TOUCHING_M])
    body = RigidBody(mesh=box, rotation=turn, translation_m=start, material="box")
    fixed = RigidBody(mesh=plate, rotation=IDENTITY, translation_m=np.zeros(3), material="plate", fixed=True)
    free = FreeBody(body, [fixed], contact=rubbing(0.0, ("box", "plate")), time_step_s=0.01)
    weight = np.array([0.0, 0.0, -GRAVITY_M_S2])
    for _ in range(20):
        free.step(weight)
    thrown = free.velocity_m_s + np.array([speed_m_s, 0.0, 0.0])
    free.scene._velocity[free._rows] += [speed_m_s, 0.0, 0.0]
    for _ in range(min(200, int(0.02 / speed_m_s / 0.01))):
        free.step(weight)
    return float(np.abs((free.velocity_m_s - thrown)[:2]).max() / speed_m_s)


def _about_z(angle_rad: float) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def work_of_cycle_j(rng: np.random.Generator, friction: float) -> tuple[float, float]:
    """Return the work that friction does on a block in a drawn closed cycle of shear and pressure, and the most stored.

    The block is led, without forces of its own, so that shear and pressure are what was drawn: shear under one force,
    another force, back, and so on to where the cycle began, twice.
    """
    plate, contact = drawn_plate(rng, 3), rubbing(friction, ("box", "plate"))
    box = box_surface((0.01, 0.012, 0.008), (-0.005, -0.006, 0.0))
    start = np.array([0.0, 0.0, TOUCHING_M])
    body = RigidBody(mesh=box, rotation=IDENTITY, translation_m=start, material="box")
    fixed = RigidBody(mesh=plate, rotation=IDENTITY, translation_m=np.zeros(3), material="plate", fixed=True)
    block = FreeBody(body, [fixed], contact=contact, time_step_s=0.1)
    scene, rows = block.scene, block._rows
    gaps_m = [_gap_m(contact, force_n / 4) for force_n in rng.uniform(0.3, 20.0, 6)]
    places = np.insert(rng.uniform(-2e-5, 2e-5, (6, 2)), 2, gaps_m, axis=1)
    way = np.concatenate([np.linspace(a, b, 9)[1:] for a, b in zip(places, np.roll(places, -1, axis=0), strict=True)])
    here, work_j, stored_j = places[0], 0.0, 0.0
    home = scene._x[rows] - start
    scene._x[rows] = home + here
    for there in np.concatenate([way, way]):
        x_start, memory = scene._x.copy(), scene._memory
        scene._x[rows] = home + there
        on_block_n = pair_forces(scene._model, scene._x, x_start, memory).forces_n.sum(axis=0)
        work_j += float(on_block_n[:2] @ (there - here)[:2])
        near = find_contacts(scene._model, scene._x)
        remembered = remember_step(scene._model, near, scene._x, x_start, memory)
        scene.restore(scene.state()._replace(memory=remembered))
        stored_j = max(stored_j, float((scene._memory.slip_m**2).sum()) * contact.tangential_stiffness_n_m / 2)
        here = there
    return work_j, stored_j
