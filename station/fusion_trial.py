"""Plays one trial of the fusion task: see which hole fits the peg, go there, and insert it by touch.

The challenge published no procedure of it on its platform, so the start, the range and the rule of success are those
of the simulation, measured by encoders and gels: pre-flight and grasp as in the trials of the peg, no descent to a
contact.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from vitac.envs.geometry.bases import HEXAGON_HOLE_Y_MM
from vitac.evaluator.episodes.episode import Policy
from vitac.evaluator.tracks import Episode

from .arm import Offset
from .outcome import TrialOutcome
from .perception.segmentation import make_segmenter, object_points_m
from .preflight import PreflightRefused
from .trial import Trial

HOLES_Y_MM: Final[Mapping[str, float]] = {"hexagon": HEXAGON_HOLE_Y_MM, "cuboid": 0.0}
"""Of the peg's own hole, from that of the cuboid, whose place the station's file has."""
_START_GAP_MM: Final = 1.0
_LOWEST_MM, _HIGHEST_MM = -7.1, 22.9
"""Heights of the peg's lower end above the rim."""
_RANGE: Final = (12.0, 30.0, 20.0)
_NEAR: Final = (6.0, 6.0, 10.0)
"""x [mm], y [mm] and angle [deg] from the peg's own hole at a success."""
_DEPTH_MM: Final = 1.0


class FusionTrial(Trial):
    """Attempts at one episode of the fusion task."""

    def _find_start(self, episode: Episode) -> Offset:
        x_mm, y_mm, theta_deg, z_mm, *_ = episode.offset
        self._start_mm = z_mm + _START_GAP_MM
        self._hole_y_mm = HOLES_Y_MM[episode.shape]
        return x_mm, y_mm + HEXAGON_HOLE_Y_MM / 2, theta_deg

    def _approach(self) -> float:
        """Go to the start, and return its height above the rim [mm]."""
        if self._station.depth_camera is None:
            raise PreflightRefused("Expected an RGB-D camera in the station's file: the fusion task needs one.")
        self._arm.go(self._arm.place(self._start, self._arm.height_mm(self._start_mm)))
        return self._start_mm

    def _insert(self, policy: Policy, start_mm: float) -> TrialOutcome:
        attempt, arm, offset, height_mm = self._attempt, self._arm, self._start, start_mm
        sight = self._look()
        while len(attempt.actions) < self._task.max_steps:
            action = policy.act(self._observe(sight))
            offset, height_mm = self._moved(offset, action), height_mm + self._scaled(action)[3]
            attempt.actions.append(np.array(action, dtype=np.float32))
            if not (self._is_within(offset, _RANGE) and _LOWEST_MM <= height_mm <= _HIGHEST_MM):
                return TrialOutcome.ERROR
            arm.go(arm.place(offset, arm.height_mm(height_mm)), self._station.procedure.step_mm_s)
            sight = self._look()
            self._show(f"step-{len(attempt.actions)}", sight)
            if sight.is_over_force():
                return TrialOutcome.TACTILE
            if height_mm < -_DEPTH_MM and self._is_within(offset, _NEAR) and self._is_relaxed():
                return TrialOutcome.SUCCESS
        return TrialOutcome.STEPS

    def _is_within(self, offset: Offset, limits: tuple[float, float, float]) -> bool:
        x_mm, y_mm, theta_deg = offset
        from_hole = (x_mm, y_mm - self._hole_y_mm, theta_deg)
        return all(math.fabs(value) <= limit for value, limit in zip(from_hole, limits, strict=True))

    def _see_scene(self) -> dict[str, NDArray[Any]]:
        camera, procedure = self._station.depth_camera, self._station.procedure
        if camera is None or not set(self._reading.sent) & {"rgb_picture", "depth_picture", "object_point_cloud"}:
            return {}
        seen = camera.read()
        values: dict[str, NDArray[Any]] = {
            "rgb_picture": np.ascontiguousarray(seen.colour[:, :, ::-1]),
            "depth_picture": seen.depth_m,
        }
        if "object_point_cloud" in self._reading.sent:
            if procedure.prompts is None:
                raise PreflightRefused("The policy reads the points of objects: add `procedure.prompts` to the file.")
            segmenter = make_segmenter(procedure.sam_weights)
            masks = [segmenter(seen, prompt) for prompt in (procedure.prompts.peg, procedure.prompts.base)]
            points = [object_points_m(mask, seen.depth_m, camera.intrinsics(), self._generator) for mask in masks]
            values["object_point_cloud"] = np.stack(points)
        return values
