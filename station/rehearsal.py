"""Plays a submission's trials on a station and gives one result; called by `vitac evaluate --station`."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from pydantic import NonNegativeInt
from vitac.envs.errors import VitacError
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.episodes.reading import make_reading
from vitac.evaluator.scoring.score import Rate, rate
from vitac.evaluator.shards.policy import load_in_sandbox
from vitac.evaluator.strict_model import StrictModel, Word, validate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import Task, Track

from .check import check_station
from .description import StationDescription, StationTask, read_description
from .outcome import TrialOutcome
from .records import TrialRecord
from .trials import Player

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from .twin.process import RunningTwin

TWIN: Final = "twin"
"""Name of a twin of public settings, in place of a station's file."""


class StationRefused(VitacError):
    """The station cannot play this; the message says what to correct, and nothing has moved."""


class RehearsalReport(StrictModel):
    """One result of trials on a station, with the outcome of each."""

    station: Word
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
    def from_trials(cls, trials: Sequence[TrialRecord], **names: str) -> Self:
        """Return the result of trials."""
        found = Counter(trial.outcome for trial in trials)
        counted = sum(count for outcome, count in found.items() if outcome.counts)
        return cls(
            rate=rate(found[TrialOutcome.SUCCESS], counted) if counted else None,
            without_result=len(trials) - counted,
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
    found = [(each.device, problem.sentence) for each in check_station(description) for problem in each.problems]
    if found:
        raise StationRefused(" ".join(f"{device}: {sentence}" for device, sentence in found))


def _start_twin(task: StationTask) -> "AbstractContextManager[RunningTwin]":
    from .twin.grasp import Mounted
    from .twin.hidden import PUBLIC_SETTINGS
    from .twin.process import twin_process

    return twin_process(PUBLIC_SETTINGS, mounted=Mounted(task=task))


def rehearse(
    player: Player,
    submission_dir: Path,
    track: Track,
    *,
    episodes: Sequence[int] | None = None,
    limits: Limits | None = None,
    on_trial: Callable[[TrialRecord], None] = lambda _: None,
) -> list[TrialRecord]:
    """Play a submission's trials, each in a fresh process of the policy.

    Args:
        player: at a station.
        submission_dir: folder of the unpacked submission.
        track: its track.
        episodes: numbers from the track's list; by default all whose shape is mounted.
        limits: of the policy; the default ones if None.
        on_trial: gets each trial as soon as it is over.

    Raises:
        StationRefused: there is nothing to play with the shape that is mounted.
        PolicyFailed: the policy cannot be loaded.
    """
    task = _find_task(track)
    procedure = player.description.procedure
    shape = procedure.shape if procedure else ""
    wanted = set(episodes) if episodes else {each.number for each in task.episodes}
    chosen = [each for each in task.episodes if each.shape == shape and each.number in wanted]
    if not chosen:
        raise StationRefused(f"Expected episodes with the {shape}, which is mounted, got none. Choose others.")
    manifest = load_manifest(submission_dir)
    reading = make_reading(task, manifest.observation_keys)
    trials = []
    with load_in_sandbox(submission_dir, limits or Limits(), track.packages) as session:
        for episode in chosen:
            attempts = player.play(task, episode, reading, lambda: session)
            trials.append(TrialRecord.from_attempts(episode, attempts))
            on_trial(trials[-1])
    return trials


def _find_task(track: Track) -> Task:
    return track.tasks[find_station_task(track)]


def find_station_task(track: Track) -> StationTask:
    """Return which task of a track stations play.

    Raises:
        StationRefused: none.
    """
    for task in StationTask:
        if task in track.tasks:
            return task
    raise StationRefused(
        f"A station plays {' and '.join(StationTask)}; {track.name} has neither. Choose a submission to another track."
    )
