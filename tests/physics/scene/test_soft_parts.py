"""Soft bodies that touch each other: gels that press on gels, and elastic parts that nothing but contact holds."""

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from block_meshes import box_surface, hexahedral_box
from numpy.typing import NDArray
from scipy.optimize import brentq
from small_scenes import IDENTITY, UPSIDE_DOWN, arena_contact, driven_positions_m
from vitac.envs.fem.model.mesh import GelBody, MeshError, RigidBody
from vitac.envs.fem.scene.layout import SceneError
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]

SIZE_M, CELLS = (0.008, 0.007, 0.004), (4, 4, 2)
GAP_M = 5e-5
G_M_S2 = 9.81


TURN_RAD = 0.1
TURNED = np.array(
    [[np.cos(TURN_RAD), -np.sin(TURN_RAD), 0.0], [np.sin(TURN_RAD), np.cos(TURN_RAD), 0.0], [0.0, 0.0, 1.0]]
)


class Stack:
    """A block on the ground, and on it another one upside down, or a rigid plate; a test moves what is above.

    The blocks are turned against each other, so that no edges of theirs lie on each other. Half a turn about the x axis
    at half the height takes one to the other.
    """

    def __init__(self, *, friction: float, rigid: bool = False) -> None:
        block = hexahedral_box(SIZE_M, CELLS)
        mesh = replace(block, rest_position_m=block.rest_position_m - [0.5 * SIZE_M[0], 0.5 * SIZE_M[1], 0.0])
        lower = GelBody(mesh=mesh, rotation=TURNED, translation_m=np.zeros(3))
        self.height_m = 2.0 * SIZE_M[2] + GAP_M
        upper = GelBody(mesh=mesh, rotation=UPSIDE_DOWN @ TURNED, translation_m=np.array([0.0, 0.0, self.height_m]))
        plate = RigidBody(
            mesh=box_surface((0.04, 0.04, 0.004), (-0.02, -0.02, SIZE_M[2] + GAP_M)),
            rotation=IDENTITY,
            translation_m=np.zeros(3),
            fixed=True,
        )
        self.gels, bodies = ([lower], [plate]) if rigid else ([lower, upper], [])
        self.scene = Scene(gels=self.gels, bodies=bodies, time_step_s=0.1, contact=arena_contact(friction))
        self._moved_m = np.zeros(3)

    def move(self, *by_m: float) -> StepReport:
        self._moved_m = self._moved_m + by_m
        targets_m = [driven_positions_m(gel) for gel in self.gels]
        if len(targets_m) == 1:
            report = self.scene.step(driven_targets_m=targets_m, displacements_m={0: self._moved_m})
        else:
            report = self.scene.step(driven_targets_m=[targets_m[0], targets_m[1] + self._moved_m])
        assert report.status is not StepStatus.NOT_CONVERGED
        return report


def test_two_equal_blocks_are_half_as_stiff_as_one_on_a_plate_and_mirror_each_other() -> None:
    # Two that mirror each other do not slide, whatever the friction; on a plate only without it.
    one, two = Stack(friction=0.0, rigid=True), Stack(friction=1.0)
    for _ in range(5):
        single, both = one.move(0.0, 0.0, -1e-4), two.move(0.0, 0.0, -2e-4)
        below, above = two.scene.gel_positions_m(0), two.scene.gel_positions_m(1)
        turned = above @ UPSIDE_DOWN + [0.0, 0.0, below[:, 2].min() + above[:, 2].max()]
        assert turned == pytest.approx(below, abs=1e-8)
        assert both.newton_iterations < 40, "a matrix without the coupling took thousands and did not arrive"
    assert both.gel_forces_n[1] == pytest.approx([-force for force in both.gel_forces_n[0]], abs=2e-3)
    pressed_m = (5e-4 + single.smallest_gap_m - GAP_M, 0.5 * (1e-3 + both.smallest_gap_m - GAP_M))
    of_one, of_each = (-report.gel_forces_n[0][2] / m for report, m in zip((single, both), pressed_m, strict=True))
    assert of_each == pytest.approx(of_one, rel=0.006)


def test_blocks_stick_and_then_slide_within_the_friction_cone_while_the_pattern_follows() -> None:
    stack, friction = Stack(friction=0.3), 0.3
    for _ in range(4):
        stack.move(0.0, 0.0, -1e-4)
    ratios = []
    for _ in range(12):
        report = stack.move(2e-4, 0.0, 0.0)
        (x, _, z), other = report.gel_forces_n
        assert (x, z) == pytest.approx((-other[0], -other[2]), abs=3e-3)
        ratios.append(x / -z)
    assert ratios[1] == pytest.approx(2.0 * ratios[0], rel=0.02), "it sticks at first"
    assert 0.9 * friction < max(ratios) <= friction
    assert ratios[-1] > 0.8 * friction


@pytest.mark.parametrize("shear_m", [5e-5, 1e-3])
def test_to_press_shear_and_release_a_block_costs_what_slides_and_never_yields_energy(shear_m: float) -> None:
    """The normal force changes while it is sheared, and the way ends where it began; a small shear sticks."""
    stack, force_n, exchanged_j = Stack(friction=0.5, rigid=True), np.zeros(3), list[float]()
    stack.move(0.0, 0.0, 1e-4)
    for way_m, parts in (
        ((0.0, 0.0, -3e-4), 6),
        ((shear_m, 0.0, 0.0), 10),
        ((0.0, 0.0, -2e-4), 4),
        ((-shear_m, 0.0, 0.0), 10),
        ((0.0, 0.0, 5e-4), 10),
    ):
        for _ in range(parts):
            before_n, part_m = force_n, np.array(way_m) / parts
            force_n = np.array(stack.move(*part_m).gel_forces_n[0])
            exchanged_j.append(float(0.5 * (before_n + force_n) @ part_m))
    assert np.abs(force_n).max() < 1e-5
    lost = sum(exchanged_j) / sum(map(abs, exchanged_j))
    assert lost == pytest.approx(0.0, abs=1e-5) if shear_m < 1e-4 else lost > 0.1


def test_a_scene_of_touching_gels_is_restored_and_copied_to_the_last_bit() -> None:
    stack = Stack(friction=0.5)
    stack.move(0.0, 0.0, -1e-4)
    before = stack.scene.state()
    stack.move(0.0, 0.0, -1e-4)
    for _ in range(4):
        stack.move(4e-4, 0.0, 0.0)
    ended = stack.scene.state_bytes()
    fresh = Stack(friction=0.5)
    for scene in (stack.scene, pickle.loads(pickle.dumps(stack.scene)), fresh.scene):  # noqa: S301 - our own
        scene.restore(before)
        again = Stack(friction=0.5)
        again.scene, again._moved_m = scene, np.array([0.0, 0.0, -1e-4])
        again.move(0.0, 0.0, -1e-4)
        for _ in range(4):
            again.move(4e-4, 0.0, 0.0)
        assert scene.state_bytes() == ended


def soft_block_over_a_floor(height_m: float, **changes: Any) -> Scene:
    anchor = GelBody(mesh=hexahedral_box(SIZE_M, (1, 1, 1)), rotation=IDENTITY, translation_m=np.full(3, 0.1))
    soft = GelBody(
        mesh=hexahedral_box(SIZE_M, CELLS).released(), rotation=IDENTITY, translation_m=np.array([0.0, 0.0, height_m])
    )
    floor = RigidBody(
        mesh=box_surface((0.04, 0.04, 0.004), (-0.016, -0.016, -0.004)),
        rotation=IDENTITY,
        translation_m=np.zeros(3),
        fixed=True,
    )
    return Scene(
        gels=[anchor, replace(soft, **changes)],
        bodies=[floor],
        time_step_s=0.01,
        contact=arena_contact(0.5),
        gravity_m_s2=(0.0, 0.0, -G_M_S2),
    )


def test_a_free_soft_part_falls_as_a_stone_and_a_driven_gel_weighs_nothing() -> None:
    scene = soft_block_over_a_floor(0.05)
    start, held = scene.gel_positions_m(1), scene.gel_positions_m(0)
    targets_m = [held[hexahedral_box(SIZE_M, (1, 1, 1)).driven_nodes], np.empty((0, 3))]
    for _ in range(4):
        scene.step(driven_targets_m=targets_m)
    fallen_m = 0.01**2 * G_M_S2 * (1 + 2 + 3 + 4)  # implicit Euler
    assert scene.gel_positions_m(1) == pytest.approx(start - [0.0, 0.0, fallen_m], abs=1e-8)
    assert scene.gel_positions_m(0) == pytest.approx(held, abs=1e-12)


def test_a_free_soft_part_rests_on_the_floor_with_its_weight() -> None:
    scene = soft_block_over_a_floor(9e-5, density_kg_m3=2e4)
    targets_m = [scene.gel_positions_m(0)[hexahedral_box(SIZE_M, (1, 1, 1)).driven_nodes], np.empty((0, 3))]
    for _ in range(30):
        report = scene.step(driven_targets_m=targets_m)
        assert report.status is not StepStatus.NOT_CONVERGED
    pairs = scene.contact_forces()
    weight_n = 2e4 * np.prod(SIZE_M) * G_M_S2
    assert np.abs(pairs.forces_n.sum(axis=0)) == pytest.approx([0.0, 0.0, weight_n], rel=2e-3, abs=1e-4)
    sunk_m = SIZE_M[2] - np.ptp(scene.gel_positions_m(1)[:, 2])
    assert 0.0 < sunk_m < 1e-4


def test_a_free_part_has_neither_driven_nor_sensing_nodes_and_no_motion() -> None:
    mesh = hexahedral_box(SIZE_M, CELLS)
    none = np.zeros(len(mesh.driven), dtype=bool)
    with pytest.raises(MeshError, match="neither driven nor sensing"):
        replace(mesh, driven=none)
    with pytest.raises(SceneError, match="no driven nodes"):
        soft_block_over_a_floor(1e-3, motion=np.zeros)


def wall(axis: int, side: int, at_m: float) -> RigidBody:
    """A fixed plate whose face is across an axis, `at_m` from the origin on one side."""
    size_m = np.array([0.03, 0.03, 0.05])
    size_m[axis] = 0.004
    low_m = -0.5 * size_m
    low_m[axis] = at_m if side > 0 else -at_m - 0.004
    return RigidBody(mesh=box_surface(size_m, low_m), rotation=IDENTITY, translation_m=np.zeros(3), fixed=True)


def test_walls_squeeze_a_free_bar_with_the_force_of_its_material() -> None:
    """A bar in a tight square hole: equal stretches across, no force along; as Lame's plug in a ring, but finite."""
    width_m, length_m, youngs_modulus_pa, poisson_ratio = 8e-3, 24e-3, 1e6, 0.45
    mesh = hexahedral_box((width_m, width_m, length_m), (3, 3, 6)).released()
    bar = GelBody(
        mesh=mesh,
        rotation=IDENTITY,
        translation_m=-0.5 * np.array([width_m, width_m, length_m]),
        youngs_modulus_pa=youngs_modulus_pa,
        poisson_ratio=poisson_ratio,
    )
    sides = [(0, 1), (0, -1), (1, 1), (1, -1)]
    walls = [wall(axis, side, 0.5 * width_m + GAP_M) for axis, side in sides]
    scene = Scene(gels=[bar], bodies=walls, time_step_s=0.1, contact=arena_contact(0.0))
    for part in (1, 2, 3, 4):
        displacements_m = {i: -1e-4 * part * side * np.eye(3)[axis] for i, (axis, side) in enumerate(sides)}
        report = scene.step(driven_targets_m=[np.empty((0, 3))], displacements_m=displacements_m)
        assert report.status is StepStatus.CONVERGED
    across, along = (np.ptp(scene.gel_positions_m(0)[:, axis]) for axis in (0, 2))
    mu_pa = 0.5 * youngs_modulus_pa / (1.0 + poisson_ratio)
    lambda_pa = youngs_modulus_pa * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    s = across / width_m
    free = brentq(lambda z: mu_pa * (z - 1.0 / z) + lambda_pa * np.log(s * s * z) / z, 0.8, 1.5)
    pressure_pa = -(mu_pa * (s - 1.0 / s) + lambda_pa * np.log(s * s * free) / s)
    pairs = scene.contact_forces()
    for number in range(1, 5):
        force_n = np.abs(pairs.forces_n[(pairs.bodies == number).any(axis=1)].sum(axis=0)).max()
        assert force_n == pytest.approx(pressure_pa * width_m * length_m, rel=0.03)
    assert along / length_m == pytest.approx(free, rel=0.005)


def test_a_slim_column_buckles_under_the_load_of_theory() -> None:
    """Both ends clamped and slightly curved; the load is read as Southwell (1932) does, theory is Haringx's (1948)."""
    width_m, length_m, youngs_modulus_pa, poisson_ratio = 6e-3, 72e-3, 1e6, 0.3
    straight = hexahedral_box((width_m, 1.5 * width_m, length_m), (2, 2, 24))
    rest_m, z = straight.rest_position_m.copy(), straight.rest_position_m[:, 2]
    rest_m[:, 0] += 1.5e-4 * (1.0 - np.cos(2.0 * np.pi * z / length_m))
    top = z > length_m - 1e-9
    mesh = replace(straight, rest_position_m=rest_m, driven=(z == 0.0) | top)
    column = GelBody(
        mesh=mesh,
        rotation=IDENTITY,
        translation_m=np.zeros(3),
        youngs_modulus_pa=youngs_modulus_pa,
        poisson_ratio=poisson_ratio,
    )
    scene, targets_m = Scene(gels=[column], bodies=[], time_step_s=0.1), driven_positions_m(column)
    upper, middle = targets_m[:, 2] > 0.5 * length_m, np.isclose(z, 0.5 * length_m)
    loads_n, bows_m = [], []
    for _ in range(8):
        targets_m = targets_m - 1.5e-4 * upper[:, None] * np.array([0.0, 0.0, 1.0])
        assert scene.step(driven_targets_m=[targets_m]).status is not StepStatus.NOT_CONVERGED
        forces_n = scene._workspace.system.gradient[mesh.driven_nodes]
        loads_n.append(-forces_n[upper, 2].sum())
        bows_m.append((scene.gel_positions_m(0)[:, 0] - straight.rest_position_m[:, 0])[middle].mean())
    # bow (1 - P / P_critical) is the same at all loads.
    (first_n, last_n), (first_m, last_m) = (loads_n[2], loads_n[-1]), (bows_m[2], bows_m[-1])
    critical_n = (last_n * last_m - first_n * first_m) / (last_m - first_m)
    shear_n = 0.5 * youngs_modulus_pa / (1.0 + poisson_ratio) * 1.5 * width_m**2
    shear_n *= 10.0 * (1.0 + poisson_ratio) / (12.0 + 11.0 * poisson_ratio)
    euler_n = 4.0 * np.pi**2 * youngs_modulus_pa * 1.5 * width_m**4 / 12.0 / length_m**2
    haringx_n = 0.5 * shear_n * (np.sqrt(1.0 + 4.0 * euler_n / shear_n) - 1.0)
    assert critical_n == pytest.approx(haringx_n, rel=0.1)


def stretching_force_n(stiffening: FloatArray | None) -> float:
    """Pull a bar of 8 cells between two driven ends by a thousandth of its length."""
    bar = hexahedral_box((6e-3, 6e-3, 32e-3), (2, 2, 8))
    ends = (bar.rest_position_m[:, 2] == 0.0) | (bar.rest_position_m[:, 2] > 31.9e-3)
    pulled = GelBody(
        mesh=replace(bar, driven=ends),
        rotation=IDENTITY,
        translation_m=np.zeros(3),
        youngs_modulus_pa=1e6,
        poisson_ratio=0.0,
        stiffening=stiffening,
    )
    scene, targets_m = Scene(gels=[pulled], bodies=[], time_step_s=0.1), driven_positions_m(pulled)
    upper = targets_m[:, 2] > 16e-3
    scene.step(driven_targets_m=[targets_m + 3.2e-5 * upper[:, None] * np.array([0.0, 0.0, 1.0])])
    return float(scene._workspace.system.gradient[pulled.mesh.driven_nodes][upper, 2].sum())


def test_a_bar_of_two_materials_is_two_springs_in_a_row() -> None:
    half_stiffer = np.where(np.arange(32) < 16, 4.0, 1.0)
    assert stretching_force_n(None) == pytest.approx(1e6 * 36e-6 * 1e-3, rel=2e-3)
    assert stretching_force_n(half_stiffer) == pytest.approx(1.6 * stretching_force_n(None), rel=2e-3)


def test_stiffening_that_is_not_a_positive_number_for_each_hexahedron_is_refused() -> None:
    for wrong in (np.ones(31), np.zeros(32), np.full(32, np.inf)):
        with pytest.raises(SceneError, match="expected a positive finite number for each of the 32 hexahedra"):
            stretching_force_n(wrong)
