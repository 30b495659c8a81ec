import numpy as np
import own_sensors
import pytest
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.evaluator.figures.starts import START, grasp_figures, smallest_det_f


def grasped(name: str, *, indentation_mm: float) -> PegInsertionEnv:
    return PegInsertionEnv(sensor=own_sensors.designed(name), indentation_mm=indentation_mm)


def test_flat_gel_is_pressed_by_what_the_grasp_closes() -> None:
    env = grasped("2 mm", indentation_mm=0.2)
    found = grasp_figures(env)
    # Deepest at the peg's edge, which digs in when the peg is lowered.
    assert found.indentation_mm == pytest.approx(inner_indentations_mm(env).max(), rel=1e-4)
    assert 0.2 < found.indentation_mm < 0.4
    # A thin layer between plates is nearly confined: E (1 - nu) / ((1 + nu) (1 - 2 nu)) times the strain.
    modulus_pa = 3e5 * 0.7 / (1.3 * 0.4)
    inner = np.median(inner_indentations_mm(env))
    assert found.force_n == pytest.approx(modulus_pa * inner / 2.0 * gripped_m2(env), rel=0.25)


def test_gel_that_is_hardly_touched_has_a_det_f_near_1() -> None:
    env = grasped("8 mm", indentation_mm=1e-3)
    env.reset(options=START)
    assert 0.95 < smallest_det_f(env.scene) < 1.0


def test_deeper_grasp_presses_harder() -> None:
    shallow, deep = (grasp_figures(grasped("ridge", indentation_mm=depth)) for depth in (0.3, 0.8))
    assert deep.force_n > 1.5 * shallow.force_n
    assert deep.indentation_mm > shallow.indentation_mm + 0.3
    assert deep.smallest_det_f < shallow.smallest_det_f


def inner_indentations_mm(env: PegInsertionEnv) -> np.ndarray:
    """How deep the sensing nodes are that the peg presses [mm]."""
    gel, pose = env.scene.gel, env.scene.sensor_pose(0)
    heights_m = ((env.scene.gel_nodes_m(0) - pose.centre_m)[gel.sensing_nodes] @ pose.rotation)[:, 2]
    depths_mm = 1e3 * (gel.rest_position_m[gel.sensing_nodes, 2] - heights_m)
    return np.asarray(depths_mm[depths_mm > 0.4 * depths_mm.max()])


def gripped_m2(env: PegInsertionEnv) -> float:
    """Area of the sensing nodes that the peg presses [m2]."""
    share = len(inner_indentations_mm(env)) / len(env.scene.gel.sensing_nodes)
    return share * 25.25e-3 * 20.75e-3
