"""Checks an uploaded evaluation log as far as that needs no simulation; called by `kinds`."""

import hashlib
from collections.abc import Iterable, Iterator

from vitac.evaluator.episodes.records import EpisodeRecord, Manifest
from vitac.evaluator.logs.checks import explain_impossible, known_without_running
from vitac.evaluator.logs.findings import Impossibility, ImpossibleReason
from vitac.evaluator.logs.log import LogReader, LogRejected, UnpackFailed, open_log
from vitac.evaluator.logs.text_2025 import Script, TextLog, TextLogRejected, read_text_log, summarize
from vitac.evaluator.logs.text_2025.recordings import explain_not_resimulated, track_and_task_names
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Task, Track, list_tracks, load_track

from ..accounts.teams import name_key
from ..errors import ProblemCode, ServiceError
from ..evaluations.logs import LogClaim
from ..settings import Settings
from ..tracks import load_known_track
from .intake import CheckedUpload, ReceivedFile

DIGITS_IN_NAME = 8
"""A log has no name of its own: it is called after the start of its digest."""


def check_log(received: ReceivedFile, owner: str, settings: Settings) -> CheckedUpload:
    """Read a log once, line by line, and keep its claims.

    Args:
        received: the body, packed or not.
        owner: the team whose submission it becomes.
        settings: how large it may be unpacked.

    Raises:
        ServiceError: it is damaged, of another team, or no evaluation by this evaluator can have made it.
    """
    try:
        with open_log(received.path, settings.log_bytes) as stream:
            reader = LogReader(stream)
            require_own_team(reader.header.team, owner)
            claim = _make_claim(reader)
            digest = reader.digest
    except LogRejected as error:
        raise rejected(str(error), error.problem, error.line) from error
    except UnpackFailed as error:
        raise rejected(str(error), error.problem, None) from error
    manifest = reader.header.manifest
    return CheckedUpload(
        kind=SubmissionKind.LOG,
        track=manifest.track,
        tasks=(manifest.task,),
        name=f"log {digest[:DIGITS_IN_NAME]}",
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=claim.stored(),
    )


def require_own_team(named: str | None, owner: str) -> None:
    """Refuse a log that names another team.

    Raises:
        ServiceError: it does.
    """
    if named is not None and name_key(named) != name_key(owner):
        raise ServiceError(
            ProblemCode.LOG_TEAM_MISMATCH,
            f"Line 1: the log names the team {named!r:.80}, but is uploaded for {owner!r}; upload it as its own team.",
            line=1,
        )


def rejected(message: str, reason: str, line: int | None) -> ServiceError:
    """Return the refusal of a file that cannot be read as one whole log."""
    return ServiceError(ProblemCode.LOG_REJECTED, message, reason=str(reason), line=line)


def impossible(impossibility: Impossibility, line: int | None) -> ServiceError:
    """Return the refusal of a log that no evaluation can have made."""
    place = f"Line {line}: " if line else ""
    return ServiceError(
        ProblemCode.LOG_IMPOSSIBLE,
        f"{place}{impossibility.message}",
        reason=impossibility.reason.value,
        line=line,
        episode=impossibility.episode,
    )


def _make_claim(reader: LogReader) -> LogClaim:
    track, task = _track_and_task(reader.header.manifest)
    kept: list[EpisodeRecord] = []
    records = _keeping(kept, reader.records())
    impossibility = explain_impossible(known_without_running(track, task), task, reader.header, records)
    if impossibility:
        raise impossible(impossibility, reader.line)
    return LogClaim.from_log(reader.header, kept)


def _track_and_task(manifest: Manifest) -> tuple[Track, Task]:
    tracks = [load_track(name) for name in list_tracks()]
    for track in tracks:
        if manifest.track == track.name and manifest.task in track.tasks:
            return track, track.tasks[manifest.task]
    tasks = ", ".join(f"{task} of {track.name}" for track in tracks for task in track.tasks)
    message = f"The log is of {manifest.task} of {manifest.track}; here are {tasks}."
    raise impossible(Impossibility(reason=ImpossibleReason.OTHER_EVALUATION, message=message), line=1)


def _keeping(kept: list[EpisodeRecord], records: Iterable[EpisodeRecord]) -> Iterator[EpisodeRecord]:
    """Yield the records as they come; keep them without infos and messages, which alone can be large."""
    for record in records:
        failure = record.failure and record.failure.model_copy(update={"message": "", "output_tail": ""})
        kept.append(record.model_copy(update={"infos": (), "failure": failure}))
        yield record


NOT_A_TEXT_LOG = "not_a_text_log"
OUT_OF_PLACE = "out_of_place"
TRUNCATED = "truncated"
"""Reasons beside those of `evaluator.logs.packing`."""

MAX_PROBLEMS = 100
"""Maximum number that is stored; the last one says how many more there are."""
MAX_CHARACTERS = 200
"""Maximum length of one problem that is stored."""


def check_text_log(received: ReceivedFile, owner: str, settings: Settings) -> CheckedUpload:
    """Read a text log and keep its claims.

    Args:
        received: the body, packed or not.
        owner: the team whose submission it becomes.
        settings: how large it may be unpacked.

    Raises:
        ServiceError: it is damaged, of another team, or not a whole evaluation of a task that we have.
    """
    try:
        with open_log(received.path, settings.log_bytes) as stream:
            log = read_text_log(stream)
        script, summary = summarize(log)
    except TextLogRejected as error:
        raise rejected(str(error), NOT_A_TEXT_LOG, error.line) from error
    except UnpackFailed as error:
        raise rejected(str(error), error.problem, None) from error
    require_own_team(log.team, owner)
    track, task = _find_task(script)
    _require_whole(log, script, task)
    digest = _compute_digest(received, settings.log_bytes)
    return CheckedUpload(
        kind=SubmissionKind.TEXT_LOG,
        track=track,
        tasks=(task.name,),
        name=f"2025 text log {digest[:DIGITS_IN_NAME]}",
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=LogClaim.from_text_log(summary, _find_first(summary.problems)).stored(),
    )


def _find_task(script: Script) -> tuple[str, Task]:
    track_name, task_name = track_and_task_names(script)
    track = load_known_track(track_name)
    if task_name not in track.tasks:
        message = f"The log is of {script.name}; the tasks of {track_name} here are {', '.join(track.tasks)}."
        raise impossible(Impossibility(reason=ImpossibleReason.OTHER_EVALUATION, message=message), None)
    return track_name, track.tasks[task_name]


def _require_whole(log: TextLog, script: Script, task: Task) -> None:
    if log.misplaced:
        raise rejected(f"L{log.problems[0].removeprefix('l')}.", OUT_OF_PLACE, log.misplaced[0])
    impossibility = explain_not_resimulated(log, script, task)
    if impossibility:
        line = (
            log.episodes[impossibility.episode - 1].line
            if impossibility.episode and impossibility.episode <= len(log.episodes)
            else None
        )
        raise impossible(impossibility, line)
    if not log.has_totals:
        raise rejected("The log ends before its totals; it was cut off.", TRUNCATED, None)


def _compute_digest(received: ReceivedFile, limit_bytes: int) -> str:
    """Return the SHA-256 [hex] of the unpacked text, equal for a log and its packed copy."""
    with open_log(received.path, limit_bytes) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _find_first(problems: tuple[str, ...]) -> tuple[str, ...]:
    more = len(problems) - MAX_PROBLEMS
    first = tuple(problem[:MAX_CHARACTERS] for problem in problems[:MAX_PROBLEMS])
    return first if more <= 0 else (*first, f"and {more} more")
