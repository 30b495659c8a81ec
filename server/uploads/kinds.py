"""What the service does with each kind of submission: how large it may be, and how it is checked and shown.

The one place of the uploads that distinguishes kinds; `evaluator.submission_kinds` says what holds of each anywhere.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from vitac.evaluator.logs.findings import LogFinding
from vitac.evaluator.submission_kinds import SubmissionKind

from ..database.models import Evaluation, Submission
from ..errors import ProblemCode
from ..logs.view import log_view
from ..settings import Settings
from ..views.logs import LogView
from .checked_upload import CheckedUpload
from .intake import ReceivedFile
from .logs import check_log
from .models import check_model
from .text_logs import check_text_log

ShowLog = Callable[[Submission, Evaluation, LogFinding | None], LogView]


@dataclass(frozen=True, kw_only=True)
class ServedKind:
    """A kind of submission as the service takes it."""

    max_bytes: Callable[[Settings], int]  #: largest body
    check: Callable[[ReceivedFile, str, Settings], CheckedUpload]  #: all rules, given the owner's name
    names_track: tuple[ProblemCode, str]  #: refusal of a body for another track, and where the body names it
    log_view: ShowLog | None = None  #: shows what a log claims and what was found about it


SERVED_KINDS: Mapping[SubmissionKind, ServedKind] = MappingProxyType(
    {
        SubmissionKind.MODEL: ServedKind(
            max_bytes=lambda settings: settings.limits.archive_packed_bytes,
            check=check_model,
            names_track=(ProblemCode.MANIFEST_REJECTED, "submission.yaml says track"),
        ),
        SubmissionKind.LOG: ServedKind(
            max_bytes=lambda settings: settings.log_bytes,
            check=check_log,
            names_track=(ProblemCode.LOG_REJECTED, "the log is of"),
            log_view=log_view,
        ),
        SubmissionKind.TEXT_LOG: ServedKind(
            max_bytes=lambda settings: settings.log_bytes,
            check=check_text_log,
            names_track=(ProblemCode.LOG_REJECTED, "the log is of"),
            log_view=log_view,
        ),
    }
)
