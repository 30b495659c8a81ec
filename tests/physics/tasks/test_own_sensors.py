"""Sensors of teams in the peg task: every gel is gripped alike, and nothing is lost or undefined."""

from dataclasses import replace

import numpy as np
import own_sensors
import pytest
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.geometry.pegs import GRIPPED_WIDTH_MM
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.evaluator.figures.starts import refined_design

START = {"shape": "trapezoid", "offset_mm_deg": (2.0, -3.0, -6.0), "rng_seed": (0, 1)}


@pytest.mark.parametrize("name", own_sensors.GELS)
def test_episode_converges_with_every_marker_finite(name: str) -> None:
    env = PegInsertionEnv(sensor=own_sensors.designed(name))
    observation, info = env.reset(options=START)
    statuses = [report.status for report in info["step_reports"]]
    for _ in range(2):
        observation, _, _, _, info = env.step(np.array([-0.5, 0.7, 0.4], dtype=np.float32))
        statuses += [report.status for report in info["step_reports"]]
        assert np.isfinite(observation["marker_flow"]).all()
        assert np.isfinite(info["surface_diff_m"]).all()
        assert info["surface_diff_m"].min() > 1e-6
    assert StepStatus.NOT_CONVERGED not in statuses
    distinct = {len(np.unique(flow, axis=0)) for flow in observation["marker_flow"][:, 0]}
    assert min(distinct) > 40


@pytest.mark.parametrize("name", own_sensors.GELS)
def test_highest_point_starts_a_tenth_of_a_millimetre_from_the_peg(name: str) -> None:
    env = PegInsertionEnv(sensor=own_sensors.designed(name), indentation_mm=1e-3)
    start = START | {"offset_mm_deg": (-4.0, -4.0, 0.0), "shape": "cuboid"}
    env.reset(options=start)
    pose = env.scene.pose
    closed_mm = 0.1 + 1e-3
    for index, side in enumerate((1.0, -1.0)):
        centre_mm = env.scene.sensor_pose(index).centre_m[1] * 1e3
        highest_mm = float(own_sensors.designed(name).gel.rest_position_m[:, 2].max()) * 1e3
        face_mm = side * (centre_mm - pose.y_m * 1e3) - highest_mm
        assert face_mm + closed_mm == pytest.approx(0.5 * GRIPPED_WIDTH_MM + 0.1, abs=1e-5)


def test_flat_gels_touch_at_the_same_grasp_travel() -> None:
    """Closed by 0.101 mm in all, all of them have come into the barrier's reach (0.1 mm), by about the same distance.

    The peg's upper end lies below that of the gels, where nothing is touched: nodes at the border are left out.
    """
    middle_mm = []
    for name in ("2 mm", "4 mm", "8 mm"):
        env = PegInsertionEnv(sensor=own_sensors.designed(name), indentation_mm=1e-3)
        env.reset(options={"shape": "cuboid", "offset_mm_deg": (0.0, 0.0, 0.0)})
        peg_y_mm = env.scene.pose.y_m * 1e3
        for index in range(2):
            x_mm, y_mm, z_mm = 1e3 * env.scene.gel_nodes_m(index)[env.scene.gel.sensing_nodes].T
            is_inner = (np.abs(x_mm) < x_mm.max() - 1.0) & (z_mm > z_mm.min() + 1.0) & (z_mm < z_mm.max() - 1.0)
            gaps_mm = np.abs(y_mm - peg_y_mm)[is_inner] - 0.5 * GRIPPED_WIDTH_MM
            assert gaps_mm.min() > 0.0
            middle_mm.append(float(np.median(gaps_mm)))
    assert max(middle_mm) < 0.1
    assert max(middle_mm) - min(middle_mm) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", ["4 mm", "dome", "ridge", "gable", "pyramids"])
def test_refining_a_gel_changes_its_surface_motion_little(name: str) -> None:
    """By under 5 % in the median over starts, at the first env step: by another mesh, and by halving its edges."""
    gel = own_sensors.GELS[name]()
    sensors = [own_sensors.design(gel), own_sensors.design(gel, wanted_nodes=550)]
    sensors.append(refined_design(sensors[0], 2.0))
    motions = []
    for refined in sensors:
        env = PegInsertionEnv(sensor=refined)
        motions.append([first_motion(env, number) for number in range(3)])
    nodes = [len(sensor.gel.rest_position_m) for sensor in sensors]
    assert 1.3 * nodes[0] < min(nodes[1:])
    coarse, *finer = np.array(motions)
    for fine in finer:
        assert np.median(np.abs(fine / coarse - 1.0)) < 0.05


def first_motion(env: PegInsertionEnv, number: int) -> list[float]:
    offset = ((-4.0, -4.0, -8.0), (-2.0, 1.0, -2.0), (2.0, -1.0, 4.0))[number]
    env.reset(options={"shape": ("cuboid", "trapezoid", "concave1")[number % 3], "offset_mm_deg": offset})
    *_, info = env.step(np.array([0.3, -0.4, 0.5], dtype=np.float32))
    return [float(value) for value in info["surface_diff_m"]]


def test_renumbering_the_nodes_changes_no_verdict() -> None:
    original = own_sensors.designed("ridge")
    order = np.random.default_rng(0).permutation(len(original.gel.rest_position_m))
    number = np.argsort(order)
    gel = replace(
        original.gel,
        rest_position_m=original.gel.rest_position_m[order],
        tetrahedra=number[original.gel.tetrahedra],
        driven=original.gel.driven[order],
        sensing=original.gel.sensing[order],
    )
    renumbered = replace(original, gel=gel, sensing_triangles=number[original.sensing_triangles])
    infos = []
    for sensor in (original, renumbered):
        env = PegInsertionEnv(sensor=sensor)
        env.reset(options=START)
        for _ in range(3):
            *_, info = env.step(np.array([-0.5, 0.7, 0.4], dtype=np.float32))
        infos.append(info)
    first, second = infos
    assert first["end_reason"] == second["end_reason"]
    np.testing.assert_allclose(first["surface_diff_m"], second["surface_diff_m"], rtol=1e-4)
    np.testing.assert_allclose(first["peg_relative_z_mm"], second["peg_relative_z_mm"], atol=1e-3)


def test_cavity_runs_from_its_own_mesh() -> None:
    sensor = own_sensors.hollow_design()
    assert len(sensor.gel.rest_position_m) > 150
    env = PegInsertionEnv(sensor=sensor)
    observation, info = env.reset(options=START)
    assert env.scene.solved
    *_, info = env.step(np.array([-0.5, 0.7, 0.4], dtype=np.float32))
    assert env.scene.solved
    assert np.isfinite(observation["marker_flow"]).all()
    solid = PegInsertionEnv(sensor=own_sensors.designed("4 mm"))
    solid.reset(options=START)
    *_, stiff = solid.step(np.array([-0.5, 0.7, 0.4], dtype=np.float32))
    assert not np.allclose(info["surface_diff_m"], stiff["surface_diff_m"], rtol=1e-2)


def test_mesh_hash_tells_designs_apart() -> None:
    hashes = {PegInsertionEnv(sensor=own_sensors.designed(name)).mesh_hash() for name in ("2 mm", "4 mm", "ridge")}
    assert len(hashes | {PegInsertionEnv().mesh_hash()}) == 4
    assert PegInsertionEnv(gel=own_sensors.designed("4 mm").gel).mesh_hash() not in hashes


def test_mesh_hash_changes_with_anything_that_a_team_draws() -> None:
    sensor = own_sensors.designed("ridge")
    moved = sensor.gel.rest_position_m.copy()
    moved[-1, 0] = np.nextafter(moved[-1, 0], 1.0)
    unsensing = sensor.gel.sensing.copy()
    unsensing[np.flatnonzero(unsensing)[0]] = False
    variants = {
        "focal length": replace(sensor, camera=sensor.camera._replace(focal_v_px=np.nextafter(325.0, 326.0))),
        "centre of the picture": replace(sensor, camera=sensor.camera._replace(centre_u_px=160.5)),
        "a marker": replace(sensor, markers_mm=np.vstack([sensor.markers_mm[:-1], sensor.markers_mm[-1] + 1e-9])),
        "order of markers": replace(sensor, markers_mm=sensor.markers_mm[::-1]),
        "one marker less": replace(sensor, markers_mm=sensor.markers_mm[:-1]),
        "a face that senses": replace(sensor, sensing_triangles=sensor.sensing_triangles[1:]),
        "a label of a node": replace(sensor, gel=replace(sensor.gel, sensing=unsensing)),
        "a node": replace(sensor, gel=replace(sensor.gel, rest_position_m=moved)),
        "order of tetrahedra": replace(sensor, gel=replace(sensor.gel, tetrahedra=sensor.gel.tetrahedra[::-1])),
    }
    hashes = {name: PegInsertionEnv(sensor=variant).mesh_hash() for name, variant in variants.items()}
    unchanged = PegInsertionEnv(sensor=replace(sensor)).mesh_hash()
    assert unchanged == PegInsertionEnv(sensor=sensor).mesh_hash()
    assert [name for name, found in hashes.items() if found == unchanged] == []
    assert len(set(hashes.values())) == len(variants)
