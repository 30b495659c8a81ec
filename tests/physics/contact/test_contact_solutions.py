"""Bodies in contact, against what statics and Coulomb say."""

from itertools import pairwise

import numpy as np
import pytest
from balance_check import Balance, BalanceCheck, assert_honest
from block_meshes import box_gel, box_surface
from engine_probe import Probe
from falling_bodies import GRAVITY_M_S2, Fall, H, on_incline, turned_about_y
from numpy.typing import NDArray
from small_scenes import IDENTITY, Grip, driven_positions_m
from vitac.envs.fem.model.mesh import GelBody, RigidBody, SurfaceMesh
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]


@pytest.mark.parametrize(("friction", "slides"), [(0.55, False), (0.45, True)])
def test_a_block_on_an_incline_slides_when_the_slope_exceeds_the_friction_coefficient(
    friction: float, slides: bool
) -> None:
    """At a slope of 1 in 2 it creeps at most at eps_v, or accelerates by g (sin - mu cos)."""
    angle = float(np.arctan(0.5))
    fall = on_incline(angle, friction)
    down = turned_about_y(angle) @ [1.0, 0.0, 0.0]
    speeds = []
    for _ in range(14):
        assert fall.step().status is not StepStatus.NOT_CONVERGED
        speeds.append(float(fall.velocity_m_s(1) @ down))
    if slides:
        expected = GRAVITY_M_S2 * (np.sin(angle) - friction * np.cos(angle))
        np.testing.assert_allclose(np.diff(speeds[6:]) / H, expected, rtol=1e-3)
    else:
        assert 0 < speeds[-1] < 0.01
        assert speeds[-1] == pytest.approx(speeds[-2], rel=1e-3)


def test_creep_on_the_incline_is_what_the_smoothed_law_gives() -> None:
    """Sticking friction of the model is viscous: mu f1(v / eps_v) = tan(slope)."""
    angle, friction, eps_v = float(np.arctan(0.5)), 0.8, 0.01
    fall = on_incline(angle, friction)
    for _ in range(14):
        fall.step()
    y = float(fall.velocity_m_s(1) @ (turned_about_y(angle) @ [1.0, 0.0, 0.0])) / eps_v
    assert friction * (2 * y - y * y) == pytest.approx(0.5, rel=1e-3)


@pytest.mark.slow
def test_squeezed_gels_push_on_the_box_as_hard_as_their_backs_are_held() -> None:
    """Along the grip, where friction has no part: both backs are held equally hard, and the box is in balance."""
    grip = Grip(friction=2.0)
    for _ in range(3):
        report = grip.squeeze(1e-4)
        assert report.status is StepStatus.CONVERGED
    forces = Probe(grip.scene).at(grip.scene._x).all_forces_n
    nodes = len(grip.gels[0].mesh.rest_position_m)
    lower, upper = forces[:nodes].sum(axis=0), forces[nodes : 2 * nodes].sum(axis=0)
    assert lower[2] > 0.5
    assert lower[2] == pytest.approx(-upper[2], abs=1e-3)
    assert report.net_force_n < 1e-3
    assert report.residual_n < 1e-4


def test_harder_squeezing_gives_smaller_gaps_and_larger_forces() -> None:
    grip = Grip(friction=0.0)
    gaps, forces = [], []
    for _ in range(4):
        gaps.append(grip.squeeze(1e-4).smallest_gap_m)
        nodes = len(grip.gels[0].mesh.rest_position_m)
        forces.append(Probe(grip.scene).at(grip.scene._x).all_forces_n[:nodes, 2].sum())
    assert all(a > b > 0 for a, b in pairwise(gaps))
    assert all(a < b for a, b in pairwise(forces))


def test_a_gripped_box_follows_the_gels() -> None:
    grip = Grip(friction=3.0)
    grip.squeeze(1.5e-4)
    grip.squeeze(1.5e-4)
    before = grip.scene.body_vertices_m(0).mean(axis=0)
    for _ in range(3):
        both = np.array([2e-4, 0.0, 0.0])
        assert grip.move(both, both).status is StepStatus.CONVERGED
    travel = grip.scene.body_vertices_m(0).mean(axis=0) - before
    assert travel[0] > 4.5e-4


def assert_apart_and_honest(report: StepReport, left: Balance) -> None:
    """Bodies stay apart whatever happens, and what is called solved is solved."""
    assert not left.overlaps
    assert report.smallest_gap_m > 0
    assert_honest(report, left)


def test_total_momentum_of_colliding_bodies_is_conserved() -> None:
    box = box_surface((0.02, 0.02, 0.01), (-0.01, -0.01, -0.005))
    fall = Fall(
        [
            RigidBody(mesh=box, rotation=IDENTITY, translation_m=np.array([0, 0, 0.0]), friction=0.3),
            RigidBody(mesh=box, rotation=IDENTITY, translation_m=np.array([0.003, 0.002, 0.0102]), friction=0.3),
        ],
        gravity_m_s2=0.0,
    )
    fall.set_velocity(1, np.array([0.005, 0.0, -0.01]))
    for _ in range(5):
        assert fall.step().status is not StepStatus.NOT_CONVERGED
        total = fall.velocity_m_s(0) + fall.velocity_m_s(1)
        np.testing.assert_allclose(total, [0.005, 0.0, -0.01], atol=2e-5)
    assert fall.velocity_m_s(0)[2] < -1e-3


def edge_up(mesh: SurfaceMesh, direction: FloatArray, height_m: float, *, fixed: bool) -> RigidBody:
    """A box turned by 45 degrees, its lengthwise edge along a direction in the x-y plane and at a height."""
    tilt = np.array([[1, 0, 0], [0, np.sqrt(0.5), -np.sqrt(0.5)], [0, np.sqrt(0.5), np.sqrt(0.5)]])
    yaw = np.array([[direction[0], -direction[1], 0], [direction[1], direction[0], 0], [0, 0, 1]])
    return RigidBody(
        mesh=mesh, rotation=yaw @ tilt, translation_m=np.array([0.0, 0.0, height_m]), friction=0.5, fixed=fixed
    )


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-3, 0.02, 1.5])
def test_edges_at_any_angle_even_parallel_keep_bodies_apart(angle: float) -> None:
    """Both ends of the mollifier, and the parallel case in which only vertices carry the contact."""
    bar = box_surface((0.03, 0.01, 0.01), (-0.015, -0.005, -0.005), "bar")
    reach = 0.005 * np.sqrt(2)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    fall = Fall(
        [
            edge_up(bar, np.array([1.0, 0, 0]), 0.0, fixed=True),
            edge_up(bar, direction, 2 * reach + 1.5e-4, fixed=False),
        ],
    )
    touched = False
    for _ in range(6):
        report = fall.step()
        assert_apart_and_honest(report, fall.balance())
        touched = touched or report.active_contacts > 0
        if angle >= 0.02:
            assert report.status is not StepStatus.NOT_CONVERGED
    assert touched


def test_a_vertex_exactly_over_an_edge_and_over_a_corner_is_carried() -> None:
    """A corner-down cube falls on the diagonal of a plate's face, then on one of its corners."""
    plate = box_surface((0.02, 0.02, 0.01), (-0.01, -0.01, -0.01), "plate")
    axis = np.array([1.0, 1.0, 1.0]) / np.sqrt(3)
    side = np.cross(axis, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis])
    cube = box_surface((0.006, 0.006, 0.006), name="cube")
    for spot in ((0.0, 0.0), (0.01, 0.01)):
        fall = Fall(
            [
                RigidBody(mesh=plate, rotation=IDENTITY, translation_m=np.zeros(3), friction=0.5, fixed=True),
                RigidBody(mesh=cube, rotation=frame, translation_m=np.array([*spot, 1.5e-4]), friction=0.5),
            ],
        )
        touched = False
        for _ in range(4):
            report = fall.step()
            assert report.status is not StepStatus.NOT_CONVERGED
            assert_apart_and_honest(report, fall.balance())
            touched = touched or report.active_contacts > 0
        assert touched


def test_gels_of_tetrahedra_that_touch_each_other_are_solved() -> None:
    mesh = box_gel((0.008, 0.007, 0.004), (3, 3, 2))
    upper = GelBody(
        mesh=mesh, rotation=np.diag([1.0, -1.0, -1.0]), translation_m=np.array([3e-4, 0.0072, 0.00805]), friction=1.0
    )
    lower = GelBody(mesh=mesh, rotation=IDENTITY, translation_m=np.zeros(3), friction=1.0)
    scene = Scene(gels=[lower, upper], bodies=[], time_step_s=H)
    check = BalanceCheck(scene)
    report = scene.step(driven_targets_m=[driven_positions_m(lower), driven_positions_m(upper) - [0, 0, 1e-4]])
    assert report.status is not StepStatus.NOT_CONVERGED
    assert report.active_contacts > 0
    assert_apart_and_honest(report, check.balance())
