"""Gels that are not the challenge's run through its scene: finer, thick and not flat."""

import numpy as np
import pytest
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GelMesh
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, Stopwatch
from vitac.envs.tactile.gel import GelCells, GelDimensions, gelsight_mini_mesh, structured_gel
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings, PegScene, PegStart

FINE = structured_gel(name="fine", cells=GelCells(x=8, y=7, layers=2))
THICK_DOME = structured_gel(
    name="thick dome", size=GelDimensions(thickness_mm=7.0, dome_mm=0.4), cells=GelCells(layers=3)
)


def grasped(gel: GelMesh) -> tuple[PegScene, tuple[StepReport, ...]]:
    """The peg scene after grasp and descent."""
    scene = PegScene(
        start=PegStart(shape=PegShape.CUBOID, offset=PegOffset(x_mm=-4.0, y_mm=1.0, theta_deg=-6.0)),
        meshes=Meshes(gel=gel),
        settings=PegInsertionSettings(),
        clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
    )
    scene.grasp()
    return scene, scene.grasped.take_reports()


def mean_indentation_mm(scene: PegScene) -> float:
    """How far the peg has pushed the left gel's sensing nodes in, on average."""
    gel, pose = scene.grasped.gel, scene.grasped.sensor_pose(0)
    now = (scene.grasped.gel_nodes_m(0) - pose.centre_m) @ pose.rotation
    return float((gel.rest_position_m - now)[gel.sensing, 2].mean() * 1e3)


@pytest.mark.parametrize("gel", [FINE, THICK_DOME], ids=lambda gel: gel.name)
def test_a_grasp_with_another_gel_is_solved(gel: GelMesh) -> None:
    scene, reports = grasped(gel)
    assert {report.status for report in reports} == {StepStatus.CONVERGED}
    assert reports[-1].active_contacts > 100
    assert min(report.smallest_det_f for report in reports) > 0.1
    assert max(report.net_force_n for report in reports) < 1e-3
    assert np.abs(scene.peg_relative_z_mm()).max() < 0.3, "the peg stands about at the plate's face"


def test_a_finer_gel_is_pushed_in_about_as_far() -> None:
    assert mean_indentation_mm(grasped(FINE)[0]) == pytest.approx(
        mean_indentation_mm(grasped(gelsight_mini_mesh())[0]), rel=0.1
    )
