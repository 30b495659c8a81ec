"""Sensors of teams in the peg task: every gel is gripped alike, and nothing is lost or undefined."""

from functools import cache

import numpy as np
import own_sensors
import pytest
from vitac.envs.fem.scene.scene import StepStatus
from vitac.envs.geometry.pegs import GRIPPED_WIDTH_MM
from vitac.envs.tactile.design import SensorDesign
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv

START = {"shape": "trapezoid", "offset_mm_deg": (2.0, -3.0, -6.0), "rng_seed": (0, 1)}


@cache
def design(name: str) -> SensorDesign:
    return own_sensors.design(own_sensors.GELS[name]())


@pytest.mark.parametrize("name", own_sensors.GELS)
def test_episode_converges_with_every_marker_finite(name: str) -> None:
    env = PegInsertionEnv(sensor=design(name))
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
    env = PegInsertionEnv(sensor=design(name), indentation_mm=1e-3)
    start = START | {"offset_mm_deg": (-4.0, -4.0, 0.0), "shape": "cuboid"}
    env.reset(options=start)
    pose = env.scene.pose
    closed_mm = 0.1 + 1e-3
    for index, side in enumerate((1.0, -1.0)):
        centre_mm = env.scene.sensor_pose(index).centre_m[1] * 1e3
        highest_mm = float(design(name).gel.rest_position_m[:, 2].max()) * 1e3
        face_mm = side * (centre_mm - pose.y_m * 1e3) - highest_mm
        assert face_mm + closed_mm == pytest.approx(0.5 * GRIPPED_WIDTH_MM + 0.1, abs=1e-5)


def test_mesh_hash_tells_designs_apart() -> None:
    hashes = {PegInsertionEnv(sensor=design(name)).mesh_hash() for name in ("2 mm", "4 mm", "ridge")}
    assert len(hashes | {PegInsertionEnv().mesh_hash()}) == 4
    assert PegInsertionEnv(gel=design("4 mm").gel).mesh_hash() not in hashes
