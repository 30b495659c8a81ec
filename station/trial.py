"""Plays one trial on a station by the challenge's procedure."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError
from vitac.evaluator.agent.verdicts import PolicyFailed
from vitac.evaluator.episodes.episode import OpenSession, PlayingPolicy
from vitac.evaluator.episodes.records import ContactForces, HelpKind, HumanHelp, Reading, TrialVideo
from vitac.evaluator.episodes.traces import OVER_FORCE_N, count_over_force, summarize_force
from vitac.evaluator.tracks import Episode, Task

from .arm import Arm, NoPeg, Offset
from .devices.stage import DeviceFault, Pose
from .eyes import OpenStation, SensorReading
from .guard import LARGEST_RADIUS_MM, LARGEST_THETA_DEG, LimitPassed, StationStopped, StopCause
from .held_part import NotRemembered
from .operators import Operator, OperatorDecision
from .outcome import TrialOutcome
from .perception.observation import NoMarkerFollowed, marker_flow, mean_by_region
from .perception.segmentation import NothingAtPrompt, SamMissing
from .preflight import PreflightFinding, PreflightRefused, check_held, check_ready, has_zero
from .video import VideoRecorder

_STILL_PICTURES: Final = 30
_THRESHOLD_PX: Final = 0.15
_THRESHOLD_FACTOR: Final = 1.25
_CONTACT_FACTOR: Final = 1.25
_REGRASP_FACTOR: Final = 2.5
_REGRASPS: Final = 3
_STARTS: Final = 3
"""That are tried, one after the other, until one is blocked."""
_RELAXED_FACTOR: Final = 3.0
_LARGE_MOVEMENT_PX: Final = 1.5
_PUSH_FACTOR: Final = 5.0
_SUCCESS_DEPTH_MM: Final = 0.35
_PAUSE_S: Final = 0.5

Pair = tuple[float, float]


class NotBlocked(VitacError):
    """The descent met nothing, at the start and at those that took its place."""


@dataclass(kw_only=True)
class Attempt:
    """What was recorded of one attempt at a trial.

    Attributes:
        start: where the policy began, as in the list.
        outcome: how it ended.
        reason: in a sentence, where the outcome alone does not say it.
        actions: that the policy gave.
        encoders: pose of the stage at the start and after each env step: x, y, z [mm], rotation [deg].
        movement_px: mean movement of the markers of both gels at those times.
        regions_px: mean movement of the markers in nine regions of both gels at those times, shape [2, 9, 2] each.
        wrenches: of the force/torque sensor at those times, over free air [N, N m].
        thresholds_px: movement of both gels that is more than noise.
        failure: of the policy.
        output: what the policy printed.
        policy_s: CPU time of the policy.
        action_numbers: how many an action has.
        marks: of the video at the times of `encoders`, where there is one.
        video: None where none was recorded whole.
        forces: on the force/torque sensor, from the descent on.
        help: of people.
        stopped_by_force: whether the limit of force or torque stopped a motion of the policy.
    """

    start: tuple[float, ...]
    outcome: TrialOutcome = TrialOutcome.REFUSED
    reason: str = ""
    actions: list[NDArray[np.float32]] = field(default_factory=list)
    encoders: list[Pose] = field(default_factory=list)
    movement_px: list[Pair] = field(default_factory=list)
    regions_px: list[NDArray[np.float64]] = field(default_factory=list)
    wrenches: list[NDArray[np.float64]] = field(default_factory=list)
    thresholds_px: Pair = (0.0, 0.0)
    failure: PolicyFailed | None = None
    output: str = ""
    policy_s: float = 0.0
    action_numbers: int = 3
    marks: list[dict[str, Any]] = field(default_factory=list)
    video: TrialVideo | None = None
    forces: ContactForces | None = None
    help: tuple[HumanHelp, ...] = ()
    stopped_by_force: bool = False


class StationTrial:
    """Attempts at one episode of the peg task.

    Attributes:
        part: what the gripper holds, in one word.

    Args:
        station: open and safe.
        task: what is played.
        episode: its fixed start.
        reading: what the policy observes.
        open_session: gives the loaded policy.
        folder: where records are written.
        show: called with a word and what is seen, for pictures.
        recorder: of the trial's video.
        operator: who may step in.
    """

    part: ClassVar = "peg"
    _motion_axes: ClassVar[tuple[int, ...]] = (0, 1, 3, 2)
    """Of the encoders' x, y, z and rotation, in the order of `relative_motion`."""

    def __init__(
        self,
        station: OpenStation,
        *,
        task: Task,
        episode: Episode,
        reading: Reading,
        open_session: OpenSession,
        folder: Path,
        show: Callable[[str, SensorReading], None] = lambda _word, _sight: None,
        recorder: VideoRecorder | None = None,
        operator: Operator | None = None,
    ) -> None:
        self._station, self._arm = station, Arm(station)
        self._task, self._reading, self._open_session = task, reading, open_session
        self._task_name = task.station_of or task.name
        self._episode = episode
        self._start = self._find_start(episode.offset)
        self._folder, self._show, self._recorder = folder, show, recorder
        self._operator = operator or Operator(asks=False)
        self._generator = np.random.default_rng((episode.list_seed, episode.number))
        self._z_step_mm = station.procedure.z_step_mm
        self._attempt = Attempt(start=episode.offset)
        self._free_wrench = np.zeros(6)

    def _find_start(self, offset: tuple[float, ...]) -> Offset:
        """Return where the peg stands at a start: x and y [mm] from the place in the file, angle [deg]."""
        x_mm, y_mm, theta_deg = offset
        return x_mm, y_mm, theta_deg

    def play(self) -> Attempt:
        """Play it, and take the part away unless the station is stopped."""
        attempt = self._attempt = Attempt(start=self._episode.offset, action_numbers=len(self._task.actions))
        try:
            attempt.outcome = self._play()
        except PolicyFailed as failed:
            attempt.outcome, attempt.reason, attempt.failure = TrialOutcome.POLICY_FAILED, failed.message, failed
        except (*_OUTCOMES, StationStopped, LimitPassed) as why:
            attempt.outcome, attempt.reason = self._outcome_of(why), str(why)
        attempt.forces = self._summarize_forces()
        self._retreat()
        return attempt

    def _play(self) -> TrialOutcome:
        operator = self._operator
        findings = check_ready(self._station, self._folder)
        if operator.asks:
            ready = "The station is ready for the trial. Accepted, it begins to move."
            checklist = (f"The {self.part} is in its garage.", "The gels are clean.", "Nobody is in reach.")
            self._ask(ready, checklist, findings=findings)
        operator.wait_while_paused(f"The {self.part} is fetched, grasped and looked at.")
        findings = self._grasp()
        while operator.asks and self._ask_about_grasp(findings) is OperatorDecision.REGRASP:
            began = monotonic()
            self._station.thresholds_px = None
            findings = self._grasp()
            operator.note_help(HelpKind.REGRASP, began)
        operator.wait_while_paused(f"The {self.part} goes to the start.")
        self._station.guard.forces_n.clear()
        start_mm = self._approach()
        with self._open_session().episode(
            task=self._task_name, action_shape=(len(self._task.actions),), clouds=self._reading.clouds
        ) as policy:
            try:
                return self._insert(policy, start_mm)
            finally:
                self._attempt.output, self._attempt.policy_s = policy.output, policy.cpu_s

    def _ask(
        self, text: str, checklist: Sequence[str], *decisions: OperatorDecision, findings: Sequence[PreflightFinding]
    ) -> OperatorDecision:
        """Return what an operator decides.

        Raises:
            PreflightRefused: the operator refused, for the reason in the note.
        """
        measured = [f"{each.name}: {each.value}" for each in findings]
        answer, note = self._operator.ask(
            text, (OperatorDecision.ACCEPT, *decisions, OperatorDecision.REFUSE), checklist, measured
        )
        if answer is OperatorDecision.REFUSE:
            raise PreflightRefused(f"An operator refused the trial: {note}")
        return answer

    def _ask_about_grasp(self, findings: Sequence[PreflightFinding]) -> OperatorDecision:
        held = f"The {self.part} hangs in free air. Accepted, the policy begins."
        checklist = (f"The {self.part} stands straight between the gels.", "It touches nothing else.")
        return self._ask(held, checklist, OperatorDecision.REGRASP, findings=findings)

    def _summarize_forces(self) -> ContactForces | None:
        """Return what the force/torque sensor measured since the descent; None where no env step was played."""
        forces_n = list(self._station.guard.forces_n) if self._attempt.actions else []
        if not forces_n:
            return None
        period_s = 1 / self._station.description.force_torque.rate_hz
        return ContactForces(
            part=summarize_force(forces_n, [period_s] * len(forces_n)),
            over_force_n=OVER_FORCE_N,
            over_force_events=count_over_force(forces_n, OVER_FORCE_N),
        )

    def _approach(self) -> float:
        """Go where the policy begins; return the stage's height at the contact [mm]."""
        contact_mm = self._find_contact()
        self._arm.go(self._arm.pose()._replace(z_mm=contact_mm - self._z_step_mm))
        return contact_mm

    def _find_contact(self) -> float:
        """Come down until a gel feels the plate, and return the stage's height there [mm].

        Of a start that is not blocked here the next one of the list takes the place, where the challenge draws another
        offset: so all policies begin at the same one.
        """
        own, episodes = self._episode, self._task.episodes
        others = (*episodes[own.number :], *episodes[: own.number])
        starts = dict.fromkeys((own.offset, *(each.offset for each in others if each.shape == own.shape)))
        tried = tuple(islice(starts, _STARTS))
        for number, offset in enumerate(tried):
            if number:
                self._operator.wait_while_paused("The start is not blocked: the next one of the list takes its place.")
            self._attempt.start, self._start = offset, self._find_start(offset)
            self._go_beside()
            if (contact_mm := self._descend()) is not None:
                return contact_mm
        timeout_s = self._station.procedure.descent_timeout_s
        raise NotBlocked(f"At none of {len(tried)} starts of the list a gel felt the plate within {timeout_s} s.")

    def _grasp(self) -> list[PreflightFinding]:
        """Hold the peg at the height beside the hole, and return what was measured of it in free air.

        It is grasped again where it has moved between the gels, or where the zero of the force/torque sensor is off:
        that is set in the garage.
        """
        arm, station = self._arm, self._station
        for _ in range(_REGRASPS):
            if station.thresholds_px is None or not arm.holds_peg():
                arm.fetch()
                station.thresholds_px = self._measure_noise()
            self._go_beside()
            has_moved = self._exceeds(arm.settle(_PAUSE_S), _REGRASP_FACTOR)
            if not has_moved and has_zero(station):
                break
            station.thresholds_px = None
        else:
            check_held(station)
            raise NoPeg(f"The peg still moves between the gels after {_REGRASPS} grasps. Clean gels and peg.")
        return self._take_references(station.thresholds_px)

    def _take_references(self, thresholds_px: Pair) -> list[PreflightFinding]:
        """Look at what is held in free air: gels and forces are compared with that afterwards."""
        self._attempt.thresholds_px = thresholds_px
        self._station.eyes.start_again()
        self._arm.settle(_PAUSE_S)
        findings = check_held(self._station)
        self._free_wrench = self._wrench()
        return findings

    def _go_beside(self) -> None:
        """Go over the start, first at the safe height where the stage is not near the hole."""
        arm, procedure = self._arm, self._station.procedure
        beside = arm.place(self._start, arm.height_mm(procedure.lateral_mm))
        if math.dist(arm.pose()[:2], beside[:2]) > 2 * LARGEST_RADIUS_MM:
            arm.lift(procedure.safe_z_mm)
            arm.go(beside._replace(z_mm=procedure.safe_z_mm))
        else:
            arm.lift(beside.z_mm)
        arm.go(beside)

    def _measure_noise(self) -> Pair:
        """Return the thresholds of both gels from still pictures, the peg held in free air."""
        self._station.eyes.start_again()
        seen = [self._station.eyes.see().movement_px() for _ in range(_STILL_PICTURES)]
        left, right = np.maximum(_THRESHOLD_PX, _THRESHOLD_FACTOR * np.mean(seen, axis=0)).tolist()
        return left, right

    def _descend(self) -> float | None:
        """Return the stage's height [mm] where a gel feels the plate; None where none does."""
        arm, procedure = self._arm, self._station.procedure
        start = arm.place(self._start, arm.height_mm(procedure.start_mm))
        arm.go(start)
        last_mm = start.z_mm - procedure.descent_timeout_s * procedure.descent_mm_s
        lowest = start._replace(z_mm=start.z_mm - procedure.descent_mm)
        sight = arm.go_until(
            lowest,
            procedure.descent_mm_s,
            lambda seen, pose: pose.z_mm <= last_mm or self._exceeds(seen, _CONTACT_FACTOR),
        )
        if sight is None or not self._exceeds(sight, _CONTACT_FACTOR):
            return None
        self._show("contact", sight)
        return arm.pose().z_mm

    def _insert(self, policy: PlayingPolicy, contact_mm: float) -> TrialOutcome:
        """Play env steps until the trial has ended."""
        attempt, arm, offset = self._attempt, self._arm, self._start
        sight = self._look()
        while len(attempt.actions) < self._task.max_steps:
            self._wait_before_step()
            action = policy.act(self._observe(sight))
            offset = self._moved(offset, action)
            attempt.actions.append(np.array(action, dtype=np.float32))
            if math.hypot(*offset[:2]) > LARGEST_RADIUS_MM or abs(offset[2]) > LARGEST_THETA_DEG:
                return TrialOutcome.ERROR
            speed_mm_s = self._station.procedure.step_mm_s
            arm.go(arm.place(offset, arm.pose().z_mm), speed_mm_s)
            depth_mm = (len(attempt.actions) + 1) * self._z_step_mm
            arm.go(arm.place(offset, contact_mm - depth_mm), speed_mm_s)
            sight = self._look()
            self._show(f"step-{len(attempt.actions)}", sight)
            if sight.is_over_force():
                return TrialOutcome.TACTILE
            if depth_mm > _SUCCESS_DEPTH_MM and self._is_relaxed() and self._passes_push_test(sight):
                return TrialOutcome.SUCCESS
        return TrialOutcome.STEPS

    def _wait_before_step(self) -> None:
        self._operator.wait_while_paused(f"Env step {len(self._attempt.actions) + 1} of {self._task.max_steps}.")

    def _look(self) -> SensorReading:
        sight = self._arm.settle()
        self._attempt.encoders.append(self._arm.pose())
        self._attempt.movement_px.append(sight.movement_px())
        self._attempt.regions_px.append(np.stack([mean_by_region(sight.left), mean_by_region(sight.right)]))
        self._attempt.wrenches.append(self._wrench() - self._free_wrench)
        if self._recorder is not None:
            self._attempt.marks.append(self._recorder.mark())
        return sight

    def _wrench(self) -> NDArray[np.float64]:
        return np.array(self._station.guard.measure_wrench())

    def _observe(self, sight: SensorReading) -> dict[str, NDArray[Any]]:
        """Return what the policy reads: markers as in simulation, motion from the stage's encoders."""
        motion = np.subtract(self._attempt.encoders[-1], self._attempt.encoders[0])
        values: dict[str, NDArray[Any]] = {
            "relative_motion": motion[list(self._motion_axes)].astype(np.float32),
            "marker_flow": marker_flow(sight.left, sight.right, self._generator),
        }
        values |= self._see_scene()
        return {name: values[name] for name in self._reading.sent}

    def _see_scene(self) -> dict[str, NDArray[Any]]:
        """Return what a camera beside the gripper sees; nothing in a task of touch alone."""
        return {}

    def _moved(self, offset: Offset, action: NDArray[np.float32]) -> Offset:
        """Return the offset after an action: scaled, clipped, turned by the angle before, as in simulation."""
        dx, dy, dtheta, *_ = self._scaled(action)
        x, y, theta_deg = offset
        angle = math.radians(theta_deg)
        turned = math.cos(angle) * dx - math.sin(angle) * dy, math.sin(angle) * dx + math.cos(angle) * dy
        return x + turned[0], y + turned[1], theta_deg + dtheta

    def _scaled(self, action: NDArray[np.float32]) -> list[float]:
        scale = np.array([component.scale for component in self._task.actions])
        return [float(value) for value in np.clip(action * scale, -scale, scale)]

    def _is_relaxed(self) -> bool:
        """Return whether both gels feel as little as a peg in its hole lets them."""
        largest_px = max(max(pair) for pair in self._attempt.movement_px)
        factor = _RELAXED_FACTOR * max(1.0, largest_px / _LARGE_MOVEMENT_PX)
        now_px = self._attempt.movement_px[-1]
        return all(now < factor * limit for now, limit in zip(now_px, self._attempt.thresholds_px, strict=True))

    def _passes_push_test(self, before: SensorReading) -> bool:
        """Push the peg down; return to the height before where a gel feels that it is stuck."""
        start = self._arm.pose()
        is_stuck = self._feels_resistance(before, start._replace(z_mm=start.z_mm - self._station.procedure.push_mm))
        if is_stuck:
            self._arm.go(start)
        return not is_stuck

    def _feels_resistance(self, before: SensorReading, target: Pose) -> bool:
        """Move until a gel feels that the part is stuck, and return whether it was."""
        limits_px = [_PUSH_FACTOR * max(value, _THRESHOLD_PX) for value in before.movement_px()]
        felt = self._arm.go_until(
            target,
            self._station.procedure.push_mm_s,
            lambda seen, _: any(now > limit for now, limit in zip(seen.movement_px(), limits_px, strict=True)),
        )
        return felt is not None

    def _exceeds(self, sight: SensorReading, factor: float) -> bool:
        thresholds_px = self._station.thresholds_px or (_THRESHOLD_PX, _THRESHOLD_PX)
        return any(now > factor * limit for now, limit in zip(sight.movement_px(), thresholds_px, strict=True))

    def _outcome_of(self, error: VitacError) -> TrialOutcome:
        """Return what ended the attempt: over-force is the policy's doing, everything else the station's."""
        seen = self._station.eyes.latest
        if isinstance(error, StationStopped):
            cause = self._station.guard.stopped_by
            if cause is StopCause.FAULT:
                return TrialOutcome.DEVICE_FAULT
            self._attempt.stopped_by_force = cause is StopCause.FORCE and bool(self._attempt.actions)
            if self._attempt.encoders and seen and seen.is_over_force():
                return TrialOutcome.TACTILE
        return next((outcome for kind, outcome in _OUTCOMES.items() if isinstance(error, kind)), TrialOutcome.STOPPED)

    def _retreat(self) -> None:
        """Take the part away unless the station is stopped for another reason than over-force."""
        guard, eyes, attempt = self._station.guard, self._station.eyes, self._attempt
        is_over_force = attempt.outcome is TrialOutcome.TACTILE
        eyes.stops_on_movement = not is_over_force  # the markers have to move back
        try:
            if is_over_force:
                guard.release()
                self._station.thresholds_px = None  # the part is to be grasped again
            if guard.reason is None:
                self._take_away()
            if is_over_force:
                eyes.start_again()
        except (StationStopped, LimitPassed, DeviceFault) as error:
            attempt.reason = f"{attempt.reason} The {self.part} was not taken away: {error}".strip()
        eyes.stops_on_movement = True

    def _take_away(self) -> None:
        """Lift the peg off the plate."""
        if self._attempt.encoders:
            self._arm.lift(self._arm.height_mm(self._station.procedure.lateral_mm))


_OUTCOMES: Final = {
    NotBlocked: TrialOutcome.NOT_BLOCKED,
    NoPeg: TrialOutcome.NO_PEG,
    PreflightRefused: TrialOutcome.REFUSED,
    NotRemembered: TrialOutcome.REFUSED,
    NothingAtPrompt: TrialOutcome.REFUSED,
    SamMissing: TrialOutcome.REFUSED,
    DeviceFault: TrialOutcome.DEVICE_FAULT,
    NoMarkerFollowed: TrialOutcome.DEVICE_FAULT,
}
