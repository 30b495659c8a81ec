"""Peg scenes without their environment, with the state after every IPC step, those of the grasp included."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.fem.scene.report import StepReport
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.scene.grasped_scene import Clocks, GraspedScene, Stopwatch
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings, PegScene, PegStart

FloatArray = NDArray[np.float64]
OffsetMmDeg = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class PegState:
    """A scene after an IPC step; the driven nodes stand exactly where they were to go."""

    gels_m: FloatArray  # [2, n, 3]
    held_m: FloatArray  # [v, 3]


class RecordedPeg:
    """A peg between two gels, as it was placed and not yet grasped."""

    def __init__(self, shape: PegShape, offset: OffsetMmDeg, *, meshes: Meshes | None = None) -> None:
        self._scene = PegScene(
            start=PegStart(shape=shape, offset=_offset(offset)),
            meshes=meshes or Meshes(),
            settings=PegInsertionSettings(),
            clocks=Clocks(physics=Stopwatch(), markers=Stopwatch()),
        )
        self.grasped: GraspedScene = self._scene.grasped
        self.states: list[PegState] = []
        self.reports: list[StepReport] = []
        self.grasped.after_ipc_step = self._record

    def grasp(self) -> None:
        """What a reset does: grasp and come down."""
        self._scene.grasp()
        self.reports.extend(self.grasped.take_reports())

    def travel(self, goal: OffsetMmDeg) -> None:
        """What an env step does, to a commanded offset from the hole."""
        self._scene.travel(_offset(goal))
        self.reports.extend(self.grasped.take_reports())

    def _record(self) -> None:
        gels_m = np.stack([self.grasped.gel_nodes_m(0), self.grasped.gel_nodes_m(1)])
        held_m = self.grasped.held_vertices_m(np.arange(len(self.grasped.held_surface.vertices_m)))
        self.states.append(PegState(gels_m=gels_m, held_m=held_m))


def _offset(offset: OffsetMmDeg) -> PegOffset:
    x_mm, y_mm, theta_deg = offset
    return PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)
