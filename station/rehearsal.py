"""Plays a submission's trials on a station and gives one result, with the stored record of each trial.

Called by `vitac evaluate --station`. Of all attempts of a trial at most the last one counts.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveInt
from vitac.errors import VitacError
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.episodes.records import ActionSequence, make_reading
from vitac.evaluator.scoring.score import Rate, rate_by_start
from vitac.evaluator.shards.policy import load_in_sandbox
from vitac.evaluator.strict_model import StrictModel, Word, validate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import Episode, Track

from .check import check_station
from .description import StationDescription, StationTask, TwinMark, read_description
from .eyes import find_procedure
from .outcome import TrialOutcome
from .trial import Attempt
from .trials import TrialPlayer

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from .twin.laboratory import RunningTwin

Pair = tuple[float, float]


def pack_actions(attempt: Attempt) -> NDArray[np.float32]:
    """Return the actions of an attempt, shape [env steps, numbers of an action]."""
    return np.array(attempt.actions, dtype=np.float32).reshape(len(attempt.actions), attempt.action_numbers)


def _rounded(values: NDArray[np.float64]) -> Any:
    """Return arrays as tuples, to a thousandth."""
    return tuple(map(_rounded, values)) if values.ndim > 1 else tuple(values.round(3).tolist())


class AttemptRecord(StrictModel):
    """One attempt at a trial; `encoders` and `movement_px` have an entry after the start and after each env step."""

    start: tuple[float, ...] = ()
    """Where the policy began, where that is not the episode's own start: this was not blocked."""
    outcome: TrialOutcome
    reason: str = ""
    actions: ActionSequence
    encoders: tuple[tuple[float, float, float, float], ...] = ()
    """Pose of the stage: x, y, z [mm], rotation [deg]."""
    movement_px: tuple[Pair, ...] = ()
    """Mean movement of the markers of the left and the right gel."""
    regions_px: tuple[tuple[tuple[Pair, ...], ...], ...] = ()
    """Of the same in nine regions of the picture, by rows: left, then right."""
    wrenches: tuple[tuple[float, float, float, float, float, float], ...] = ()
    """Of the force/torque sensor over free air [N, N m]."""
    thresholds_px: Pair
    """Movement of both gels that is more than noise."""
    policy_s: NonNegativeFloat
    output: str = ""

    @classmethod
    def from_attempt(cls, episode: Episode, attempt: Attempt) -> Self:
        """Return the record of an attempt."""
        return cls(
            start=() if attempt.start == episode.offset else attempt.start,
            outcome=attempt.outcome,
            reason=attempt.reason,
            actions=ActionSequence.from_array(pack_actions(attempt)),
            encoders=tuple(attempt.encoders),
            movement_px=tuple(attempt.movement_px),
            regions_px=tuple(_rounded(each) for each in attempt.regions_px),
            wrenches=tuple(_rounded(each) for each in attempt.wrenches),
            thresholds_px=attempt.thresholds_px,
            policy_s=attempt.policy_s,
            output=attempt.output,
        )


class TrialRecord(StrictModel):
    """One trial. It has a result only if its last attempt counts."""

    episode: PositiveInt
    shape: Word
    offset: tuple[float, ...]
    attempts: tuple[AttemptRecord, ...] = Field(min_length=1)

    @property
    def outcome(self) -> TrialOutcome:
        """How the last attempt ended."""
        return self.attempts[-1].outcome

    @property
    def start(self) -> tuple[float, ...]:
        """Where the policy began in the last attempt."""
        return self.attempts[-1].start or self.offset

    @classmethod
    def from_attempts(cls, episode: Episode, attempts: list[Attempt]) -> Self:
        """Return the record of a trial."""
        return cls(
            episode=episode.number,
            shape=episode.shape,
            offset=episode.offset,
            attempts=tuple(AttemptRecord.from_attempt(episode, each) for each in attempts),
        )


TWIN: Final = "twin"
"""Name of a twin of public settings, in place of a station's file."""


class StationRefused(VitacError):
    """The station cannot play this; the message says what to correct, and nothing has moved."""


class RehearsalReport(StrictModel):
    """One result of trials on a station, with the outcome of each."""

    station: Word
    twin: TwinMark | None = None
    """Where the station is a twin."""
    hole: tuple[float, float, float, float] | None = None
    """Pose of the stage at the hole, from the station's file: x, y, z [mm], rotation [deg]."""
    submission: str
    submission_digest: str
    track: Word
    task: Word
    rate: Rate | None
    """Of the trials that have a result; None without any."""
    without_result: NonNegativeInt
    """Trials none of whose attempts counted."""
    trials: tuple[TrialRecord, ...]

    @classmethod
    def from_trials(cls, trials: Sequence[TrialRecord], **names: Any) -> Self:
        """Return the result of trials."""
        ends = [
            ((trial.shape, trial.start), trial.outcome is TrialOutcome.SUCCESS)
            for trial in trials
            if trial.outcome.counts
        ]
        return cls(
            rate=rate_by_start(ends) if ends else None,
            without_result=len(trials) - len(ends),
            trials=tuple(trials),
            **names,
        )


@contextmanager
def found_station(named: str, task: StationTask = StationTask.PEG) -> Iterator[StationDescription]:
    """Return the station of a file, or start a twin of public settings; refuse one whose devices are not right.

    Raises:
        StationRefused: a sentence for each thing that is wrong with it.
    """
    with _start_twin(task) if named == TWIN else nullcontext() as twin:
        description = validate(StationDescription, twin.description, TWIN) if twin else read_description(Path(named))
        refuse_wrong_devices(description)
        yield description


def refuse_wrong_devices(description: StationDescription) -> None:
    """Check all devices before anything moves.

    Raises:
        StationRefused: a sentence for each thing that is wrong.
    """
    problems = [(each.device, problem.sentence) for each in check_station(description) for problem in each.problems]
    if problems:
        raise StationRefused(" ".join(f"{device}: {sentence}" for device, sentence in problems))


def _start_twin(task: StationTask) -> "AbstractContextManager[RunningTwin]":
    from vitac.envs.geometry.keys_and_locks import KeyShape

    from .twin.grasp import Mounted
    from .twin.hidden import PUBLIC_SETTINGS
    from .twin.laboratory import twin_process

    mounted = Mounted(task, KeyShape.KEY1) if task is StationTask.LOCK else Mounted(task)
    return twin_process(PUBLIC_SETTINGS, mounted=mounted)


def rehearse(
    player: TrialPlayer,
    submission_dir: Path,
    track: Track,
    *,
    episodes: Sequence[int] | None = None,
    on_trial: Callable[[TrialRecord], None] = lambda _: None,
) -> list[TrialRecord]:
    """Play a submission's trials, each in a fresh process of the policy.

    Args:
        player: at a station.
        submission_dir: folder of the unpacked submission.
        track: its track.
        episodes: numbers from the track's list; by default all whose shape is mounted.
        on_trial: gets each trial as soon as it is over.

    Raises:
        StationRefused: there is nothing to play with the parts that are mounted.
        PolicyFailed: the policy cannot be loaded.
    """
    manifest, procedure = load_manifest(submission_dir), find_procedure(player.description)
    if procedure.task not in manifest.tasks:
        got = " and ".join(manifest.tasks)
        raise StationRefused(f"Expected a submission to {procedure.task}, as `procedure.task` says, got one to {got}.")
    task, shape = track.tasks[procedure.task], procedure.shape
    wanted = set(episodes) if episodes else {each.number for each in task.episodes}
    chosen = [each for each in task.episodes if each.shape == shape and each.number in wanted]
    if not chosen:
        raise StationRefused(f"Expected episodes with the {shape}, which is mounted, got none. Choose others.")
    reading = make_reading(task, manifest.observation_keys)
    trials = []
    with load_in_sandbox(submission_dir, Limits(), track.packages) as session:
        for episode in chosen:
            attempts = player.play(task, episode, reading, lambda: session)
            trials.append(TrialRecord.from_attempts(episode, attempts))
            on_trial(trials[-1])
    return trials


def find_station_task(tasks: Collection[str]) -> StationTask:
    """Return the first of a submission's tasks that stations play.

    Raises:
        StationRefused: none.
    """
    for task in StationTask:
        if task in tasks:
            return task
    raise StationRefused(
        f"A station plays {', '.join(StationTask)}; the submission plays {', '.join(tasks)}. Choose another one."
    )
