"""Checks an uploaded text log of the 2025 challenge; called by `kinds`.

Refused is what is not one whole log of a task that we have. Numbers that do not follow from each other are no reason to
refuse: they are shown with the log.
"""

import hashlib

from vitac.evaluator.logs.findings import Impossibility, ImpossibleReason
from vitac.evaluator.logs.packing import UnpackFailed, open_log
from vitac.evaluator.logs.text_2025 import Script, TextLog, TextLogRejected, read_text_log, summarize
from vitac.evaluator.logs.text_2025.recordings import explain_not_resimulated, track_and_task_names
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Task

from ..logs.claims import LogClaim
from ..settings import Settings
from ..tracks import load_known_track
from .checked_upload import CheckedUpload
from .intake import ReceivedFile
from .logs import DIGITS_IN_NAME, impossible, rejected, require_own_team

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
    found = explain_not_resimulated(log, script, task)
    if found:
        line = log.episodes[found.episode - 1].line if found.episode and found.episode <= len(log.episodes) else None
        raise impossible(found, line)
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
