"""Plays trials one after the other, those of the fusion task too, and repeats those that did not count.

Which are repeated is one stated rule (`outcome`). The challenge published no procedure of the fusion task on its
platform, so its start, range and rule of success are ours.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from vitac.envs.geometry.bases import HEXAGON_HOLE_Y_MM
from vitac.evaluator.episodes.episode import OpenSession, PlayingPolicy
from vitac.evaluator.episodes.records import Reading
from vitac.evaluator.tracks import Episode, Task

from .arm import Offset
from .description import StationDescription, StationTask
from .devices.stage import DeviceFault, DeviceNotFound
from .eyes import OpenStation, SensorReading, open_station
from .held_part import HeldPart
from .lock_trial import LockTrial
from .operators import Operator
from .outcome import ATTEMPTS, TrialOutcome
from .perception.segmentation import make_segmenter, object_points_m
from .preflight import PreflightRefused
from .trial import Attempt, StationTrial
from .video import VideoRecorder

HOLES_Y_MM: Final[Mapping[str, float]] = {"hexagon": HEXAGON_HOLE_Y_MM, "cuboid": 0.0}
"""Of the peg's own hole, from that of the cuboid, whose place the station's file has."""
_START_GAP_MM: Final = 1.0
_LOWEST_MM, _HIGHEST_MM = -7.1, 22.9
"""Heights of the peg's lower end above the rim."""
_RANGE: Final = (12.0, 30.0, 20.0)
_NEAR: Final = (6.0, 6.0, 10.0)
"""x [mm], y [mm] and angle [deg] from the peg's own hole at a success."""
_DEPTH_MM: Final = 1.0


class FusionTrial(StationTrial):
    """Attempts at one episode of the fusion task."""

    def _find_start(self, offset: tuple[float, ...]) -> Offset:
        x_mm, y_mm, theta_deg, z_mm, *_ = offset
        self._start_mm = z_mm + _START_GAP_MM
        self._hole_y_mm = HOLES_Y_MM[self._episode.shape]
        return x_mm, y_mm + HEXAGON_HOLE_Y_MM / 2, theta_deg

    def _approach(self) -> float:
        """Go to the start, and return its height above the rim [mm]."""
        if self._station.depth_camera is None:
            raise PreflightRefused("Expected an RGB-D camera in the station's file: the fusion task needs one.")
        self._arm.go(self._arm.place(self._start, self._arm.height_mm(self._start_mm)))
        return self._start_mm

    def _insert(self, policy: PlayingPolicy, start_mm: float) -> TrialOutcome:
        attempt, arm, offset, height_mm = self._attempt, self._arm, self._start, start_mm
        sight = self._look()
        while len(attempt.actions) < self._task.max_steps:
            self._wait_before_step()
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


Show = Callable[[int, int, str, SensorReading], None]


@dataclass(kw_only=True)
class TrialPlayer:
    """Plays trials on a station; use it in `with`, which opens the devices when a trial needs them.

    Attributes:
        description: of the station.
        folder: where records are written.
        operator: who may step in, and whom it asks before it moves again after a stop.
        attempts: at a trial.
        show: called with episode, attempt, a word and what is seen.
        share: called with the trial's code and each picture of its video (JPEG).
        held: where the gripper has closed on its part.
    """

    description: StationDescription
    folder: Path
    operator: Operator = field(default_factory=lambda: Operator(asks=False))
    attempts: int = ATTEMPTS
    show: Show = lambda _episode, _attempt, _word, _sight: None
    share: Callable[[str, bytes], None] = lambda _code, _jpeg: None
    held: HeldPart = field(default_factory=HeldPart)
    _opened: ExitStack = field(default_factory=ExitStack)
    _station: OpenStation | None = None
    _stopped_for: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    @property
    def video_file(self) -> Path:
        """Where the video of the last attempt is."""
        return self.folder / "trial.mjpeg"

    def play(
        self,
        task: Task,
        episode: Episode,
        reading: Reading,
        open_session: OpenSession,
        code: str | None = None,
        *,
        was_stopped_by_force: bool = False,
    ) -> list[Attempt]:
        """Play a trial until an attempt counts, at most `attempts` times, and return all of them.

        One whose policy is stopped by the limit of force or torque is repeated once; then it counts as over-force.

        Args:
            task: that is played.
            episode: its start.
            reading: what the policy observes.
            open_session: gives the loaded policy.
            code: one-time code of the trial; without one no video is recorded.
            was_stopped_by_force: whether the limit of force or torque ended an attempt before.
        """
        played: list[Attempt] = []
        while len(played) < self.attempts and not (played and played[-1].outcome.counts):
            if stopped_for := self._stopped_for or self.operator.stop_reason:
                self.operator.make_safe(stopped_for)
                self._stopped_for = None
            self.operator.begin(_describe(task, episode, len(played) + 1, code))
            attempt = self._attempt(task, episode, reading, open_session, len(played) + 1, code)
            if attempt.stopped_by_force and was_stopped_by_force:
                attempt.outcome = TrialOutcome.TACTILE
            was_stopped_by_force |= attempt.stopped_by_force
            played.append(attempt)
        return played

    @property
    def station(self) -> OpenStation | None:
        """The open devices; None while they are closed."""
        return self._station

    def stop(self, reason: str) -> None:
        """Stop what moves; the running attempt ends and does not count. Called from any thread."""
        self.operator.cancel(reason)
        self._hold(reason)

    def stop_by_operator(self, reason: str) -> None:
        """Stop what moves until an operator has released it; the running attempt does not count.

        Raises:
            DecisionRefused: it is stopped already.
        """
        self._hold(reason)
        self.operator.stop(reason)

    def _hold(self, reason: str) -> None:
        station = self._station
        if station is not None:
            station.guard.stop(reason)

    def _attempt(
        self,
        task: Task,
        episode: Episode,
        reading: Reading,
        open_session: OpenSession,
        number: int,
        code: str | None,
    ) -> Attempt:
        try:
            station = self._open()
        except (DeviceFault, DeviceNotFound) as error:
            self._close()
            self._stopped_for = str(error)
            return Attempt(start=episode.offset, outcome=TrialOutcome.DEVICE_FAULT, reason=str(error))
        kind = _TRIALS[StationTask(task.station_of or task.name)]
        recorder = None if code is None else VideoRecorder(station, self.video_file, code, self.share)
        station.eyes.rests = False
        with recorder or nullcontext():
            attempt = kind(
                station,
                task=task,
                episode=episode,
                reading=reading,
                open_session=open_session,
                folder=self.folder,
                show=lambda word, sight: self.show(episode.number, number, word, sight),
                recorder=recorder,
                operator=self.operator,
            ).play()
        station.eyes.rests = True
        attempt.video = recorder.video if recorder else None
        attempt.help = self.operator.end() if attempt.outcome.counts else ()
        if station.guard.reason is not None or attempt.outcome in _OPENED_AGAIN:
            self._stopped_for = attempt.reason
            self._close()
        return attempt

    def _open(self) -> OpenStation:
        if self._station is None:
            self._station = self._opened.enter_context(open_station(self.description, self.held))
        return self._station

    def _close(self) -> None:
        self._station = None
        self._opened.close()
        self._opened = ExitStack()


def _describe(task: Task, episode: Episode, attempt: int, code: str | None) -> dict[str, Any]:
    """Return what operators see of a trial: nothing that says whose policy plays."""
    x_mm, y_mm, third, *_ = episode.offset
    is_turned = any(component.name == "theta" for component in task.actions)
    return {
        "task": task.title,
        "shape": episode.shape,
        "start": f"x {x_mm:g} mm, y {y_mm:g} mm, " + (f"turned {third:g} degrees" if is_turned else f"z {third:g} mm"),
        "attempt": attempt,
        "code": code,
    }


_TRIALS: Final = {StationTask.PEG: StationTrial, StationTask.LOCK: LockTrial, StationTask.FUSION: FusionTrial}
_OPENED_AGAIN: Final = frozenset(
    {TrialOutcome.DEVICE_FAULT, TrialOutcome.STOPPED, TrialOutcome.REFUSED, TrialOutcome.NO_PEG}
)
