"""Checks an uploaded evaluation log as far as that needs no simulation; called by `kinds`."""

from collections.abc import Iterable, Iterator

from vitac.evaluator.episodes.records import EpisodeRecord, Manifest
from vitac.evaluator.logs.checks import explain_impossible, known_without_running
from vitac.evaluator.logs.findings import Impossibility, ImpossibleReason
from vitac.evaluator.logs.log import LogReader, LogRejected
from vitac.evaluator.logs.packing import UnpackFailed, open_log
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Task, Track, list_tracks, load_track

from ..accounts.teams import name_key
from ..errors import ProblemCode, ServiceError
from ..logs.claims import LogClaim
from ..settings import Settings
from .checked_upload import CheckedUpload
from .intake import ReceivedFile

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


def impossible(found: Impossibility, line: int | None) -> ServiceError:
    """Return the refusal of a log that no evaluation can have made."""
    place = f"Line {line}: " if line else ""
    return ServiceError(
        ProblemCode.LOG_IMPOSSIBLE,
        f"{place}{found.message}",
        reason=found.reason.value,
        line=line,
        episode=found.episode,
    )


def _make_claim(reader: LogReader) -> LogClaim:
    track, task = _track_and_task(reader.header.manifest)
    kept: list[EpisodeRecord] = []
    records = _keeping(kept, reader.records())
    found = explain_impossible(known_without_running(track, task), task, reader.header, records)
    if found:
        raise impossible(found, reader.line)
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
