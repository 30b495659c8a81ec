"""An elastic plug, and a cable's end, that two gels press on a plate and into a hole: balance, friction, buckling."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from intersection_check import GraspedSceneCheck
from scipy.optimize import brentq
from small_scenes import IDENTITY, driven_positions_m
from vitac.envs.fem.model.mesh import GelBody
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.scene.gripper import SENSOR_COUNT
from vitac.envs.tasks.settings import arena_physics
from vitac.envs.tasks.soft_plug.env import (
    CELLS,
    FORMS,
    POISSON_RATIO,
    CableEndEnv,
    CableShape,
    SoftPlugEnv,
    plug_mesh,
    stiffening,
    touch_then_push,
)

HELD, FIXED = SENSOR_COUNT, SENSOR_COUNT + 1
GEL_FRICTION, PART_FRICTION = 1.0, 0.3
BESIDE = {"shape": "stopper", "offset_mm": (2.0, 0.5), "rng_seed": (0, 1)}
DOWN = [0.0, 0.0, -0.5]


def pressed(*actions: list[float], start: dict[str, Any] = BESIDE, **settings: Any) -> Any:
    env = SoftPlugEnv(**settings)
    env.reset(options=start)
    for action in actions:
        env.step(np.array(action, dtype=np.float32))
    assert env.scene.solved
    return env


@pytest.fixture(scope="module")
def beside_the_hole() -> Any:
    """The plug stands on the edge of the hole."""
    return pressed(*[DOWN] * 5)


def test_plate_and_gels_hold_the_plug_in_balance(beside_the_hole: Any) -> None:
    scene = beside_the_hole.scene
    from_plate_n = scene.force_on_held_n(FIXED)
    total_n = sum(scene.force_on_held_n(other) for other in (0, 1, FIXED))
    assert from_plate_n[2] > 3.0
    assert np.abs(total_n).max() < 0.01
    assert scene.contact_forces_n()[0] == pytest.approx(from_plate_n, abs=0.01)
    assert scene.gripper_width_m < 9.5e-3


def test_every_contact_of_the_plug_stays_in_its_friction_cone(beside_the_hole: Any) -> None:
    pairs = beside_the_hole.scene.pair_forces()
    for other, friction in ((0, GEL_FRICTION), (1, GEL_FRICTION), (FIXED, PART_FRICTION)):
        of_both = (np.sort(pairs.bodies, axis=1) == (min(HELD, other), max(HELD, other))).all(axis=1)
        normal_n = (pairs.forces_n[of_both] * pairs.normals[of_both]).sum(axis=1)
        tangential = pairs.forces_n[of_both] - normal_n[:, None] * pairs.normals[of_both]
        assert of_both.sum() > 2
        assert (np.linalg.norm(tangential, axis=1) <= 1.001 * friction * np.abs(normal_n) + 1e-6).all()


def test_supported_side_is_lifted_and_the_plate_pushes_towards_the_hole(beside_the_hole: Any) -> None:
    scene, heights_mm = beside_the_hole.scene, beside_the_hole.task_scene.heights_mm()
    x_mm = 1e3 * scene.held_vertices_m(beside_the_hole.task_scene.measured_vertices)[:, 0]
    assert heights_mm[x_mm > 2.0].min() > heights_mm[x_mm < 2.0].max() + 0.5
    assert scene.force_on_held_n(FIXED)[0] < -0.3


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["stopper", "slim"])
def test_with_the_truth_the_plug_goes_in_unbuckled_and_nothing_penetrates(shape: str) -> None:
    env = SoftPlugEnv(force_limit_n=8.0)
    observation, info = env.reset(options=BESIDE | {"shape": shape})
    check = GraspedSceneCheck(env.scene)
    while info["end_reason"] is None:
        observation, *_, info = env.step(touch_then_push(observation, info))
        assert not check.intersects(env.scene)
        assert all(report.status is not StepStatus.NOT_CONVERGED for report in info["step_reports"])
    assert info["end_reason"] == "success"
    assert info["largest_bend_mm"] < env.settings.largest_bend_mm
    assert env.scene.force_on_held_n(FIXED)[2] > 0.5, "the hole is tight"


def test_pushed_straight_down_beside_the_hole_it_is_crushed_or_snaps_in_bent() -> None:
    env = SoftPlugEnv(force_limit_n=8.0)
    _, info = env.reset(options=BESIDE)
    while info["end_reason"] is None:
        *_, info = env.step(np.array(DOWN, dtype=np.float32))
    assert info["end_reason"] in {"force", "error"}


@pytest.mark.slow
def test_half_the_step_of_time_gives_the_same(beside_the_hole: Any) -> None:
    finer = pressed(*[DOWN] * 5, ipc_steps=8, physics=replace(arena_physics(), time_step_s=0.05))
    force_n = beside_the_hole.scene.force_on_held_n(FIXED)
    assert finer.scene.force_on_held_n(FIXED) == pytest.approx(force_n, rel=0.02, abs=0.02)
    assert finer.task_scene.heights_mm() == pytest.approx(beside_the_hole.task_scene.heights_mm(), abs=0.02)


@pytest.mark.slow
def test_finer_cells_of_the_plug_change_little(beside_the_hole: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.envs.tasks.soft_plug.env.CELLS", replace(CELLS, layers=14))
    finer = pressed(*[DOWN] * 5)
    force_n = beside_the_hole.scene.force_on_held_n(FIXED)
    assert finer.scene.force_on_held_n(FIXED)[2] == pytest.approx(force_n[2], rel=0.05)


CABLE_BESIDE = {"offset_mm": (0.8, -1.4), "rng_seed": (0, 1)}
NECK_MM, CONE_MM = (8.0, 20.0), 1.5


def pressed_cable(env_steps: int, **settings: Any) -> Any:
    env = CableEndEnv(**settings)
    env.reset(options=CABLE_BESIDE)
    for _ in range(env_steps):
        env.step(np.array(DOWN, dtype=np.float32))
    assert env.scene.solved
    return env


@pytest.mark.parametrize(("offset_mm", "force_n"), [((0.8, -1.4), (0.5, 2.0)), ((-2.5, -1.6), (2.0, 5.0))])
def test_pressed_beside_the_hole_the_boot_buckles_before_the_connector_is_crushed(
    offset_mm: tuple[float, float], force_n: tuple[float, float]
) -> None:
    env = CableEndEnv(force_limit_n=5.0)
    _, info = env.reset(options={"offset_mm": offset_mm, "rng_seed": (0, 1)})
    check, largest_n = GraspedSceneCheck(env.scene), 0.0
    while info["end_reason"] is None:
        *_, info = env.step(np.array(DOWN, dtype=np.float32))
        largest_n = max(largest_n, *(report.part_force_n for report in info["step_reports"]))
        assert not check.intersects(env.scene)
    assert info["end_reason"] == "error"
    assert force_n[0] < largest_n < force_n[1]


def test_with_the_truth_the_connector_touches_the_plate_and_then_goes_in_and_nothing_presses_on_it() -> None:
    env, forces_n = CableEndEnv(force_limit_n=5.0), []
    observation, info = env.reset(options=CABLE_BESIDE)
    while info["end_reason"] is None:
        observation, *_, info = env.step(touch_then_push(observation, info))
        forces_n.append(env.scene.force_on_held_n(FIXED)[2])
    assert info["end_reason"] == "success"
    assert max(forces_n[:2]) > 0.5
    assert max(forces_n[3:]) < 0.1


def haringx_load_n(width_mm: float, length_mm: float, youngs_modulus_mpa: float) -> float:
    """Return the load at which a clamped column buckles, with the length and the section that it has under this load.

    Haringx (1948), the length from the balance of a block of neo-Hookean rubber with free sides.
    """
    area, second_moment = 0.9109, 0.06707  # of a square of side 1 with the plug's rounded corners
    mu = youngs_modulus_mpa / (2.0 * (1.0 + POISSON_RATIO))
    lame = youngs_modulus_mpa * POISSON_RATIO / ((1.0 + POISSON_RATIO) * (1.0 - 2.0 * POISSON_RATIO))
    shear_factor = 10.0 * (1.0 + POISSON_RATIO) / (12.0 + 11.0 * POISSON_RATIO)

    def side(along: float) -> float:
        return float(brentq(lambda s: mu * (s - 1.0 / s) + lame * np.log(s * s * along) / s, 0.9, 2.0))

    def load_n(along: float) -> float:
        pressure = -(mu * (along - 1.0 / along) + lame * np.log(side(along) ** 2 * along) / along)
        return float(area * width_mm**2 * pressure)

    def critical_n(along: float) -> float:
        wide = width_mm * side(along)
        euler = 4.0 * np.pi**2 * youngs_modulus_mpa * second_moment * wide**4 / (length_mm * along) ** 2
        shear = shear_factor * mu * area * wide**2
        return float(0.5 * shear * (np.sqrt(1.0 + 4.0 * euler / shear) - 1.0))

    return critical_n(brentq(lambda along: load_n(along) - critical_n(along), 0.75, 0.999))


def test_neck_of_the_boot_buckles_under_the_load_of_theory() -> None:
    """The connector and the upper part are clamped, the neck is slightly curved; the load ends on a plateau."""
    mesh, modulus_mpa = plug_mesh(CableShape.CABLE), 5.0
    rest_m, z_mm = mesh.rest_position_m.copy(), 1e3 * mesh.rest_position_m[:, 2]
    along = np.clip((z_mm - NECK_MM[0]) / (NECK_MM[1] - NECK_MM[0]), 0.0, 1.0)
    rest_m[:, 0] += 3e-5 * (1.0 - np.cos(2.0 * np.pi * along))
    clamped = (z_mm < NECK_MM[0]) | (z_mm > NECK_MM[1] + 0.5 * CONE_MM)
    boot = GelBody(
        mesh=replace(mesh, rest_position_m=rest_m, driven=clamped, sensing=~clamped),
        rotation=IDENTITY,
        translation_m=np.zeros(3),
        youngs_modulus_pa=1e6 * modulus_mpa,
        poisson_ratio=POISSON_RATIO,
        stiffening=stiffening(CableShape.CABLE, mesh),
    )
    scene, targets_m, loads_n = Scene(gels=[boot], bodies=[], time_step_s=0.1), driven_positions_m(boot), []
    upper = targets_m[:, 2] > 14e-3
    for _ in range(13):
        targets_m = targets_m - 2e-4 * upper[:, None] * np.array([0.0, 0.0, 1.0])
        assert scene.step(driven_targets_m=[targets_m]).status is not StepStatus.NOT_CONVERGED
        loads_n.append(-scene._workspace.system.gradient[boot.mesh.driven_nodes][upper, 2].sum())
    to_the_end_mm, to_the_middle_mm = (NECK_MM[1] - NECK_MM[0] + part * CONE_MM for part in (1.0, 0.5))
    assert haringx_load_n(3.0, to_the_end_mm, modulus_mpa) < max(loads_n)
    assert max(loads_n) < haringx_load_n(3.0, to_the_middle_mm, modulus_mpa)
    assert loads_n[-1] < max(loads_n)


@pytest.mark.slow
def test_half_the_step_of_time_and_finer_cells_change_the_force_on_a_cable_little(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    coarse = pressed_cable(3)
    shorter = pressed_cable(3, ipc_steps=8, physics=replace(arena_physics(), time_step_s=0.05))
    form = FORMS[CableShape.CABLE]
    neck = [(8.0 + 0.5 * layer, 3.0) for layer in range(25)]
    levels_mm = (*form.levels_mm[:3], *neck, *form.levels_mm[16:])
    monkeypatch.setitem(FORMS, CableShape.CABLE, form._replace(levels_mm=levels_mm, neck=range(3, 28)))
    monkeypatch.setattr("vitac.envs.tasks.soft_plug.env.CELLS", replace(CELLS, x=4, y=4))
    finer = pressed_cable(3)
    force_n = coarse.scene.force_on_held_n(FIXED)
    assert force_n[2] > 0.9
    for other in (shorter, finer):
        assert other.scene.force_on_held_n(FIXED) == pytest.approx(force_n, rel=0.01, abs=0.01)
        assert other.task_scene.bend_mm() == pytest.approx(coarse.task_scene.bend_mm(), rel=0.01)
