"""Tables of the service, in groups. The migrations make them; a test holds both together.

Ids that people see are random UUIDs, times are UTC with zone, states are text under a CHECK with a transition trigger.
"""

from .accounts import ApiToken, AuditEntry, Invitation, Member, Team, TeamQuota
from .base import Base
from .by_hand import Brief, EnteredResult, HumanBaseline
from .competition import CompetitionRow, Qualification, Rejudgement, SealedList
from .evaluations import (
    ALL_TASKS,
    ActionTrace,
    ArchiveCopy,
    BoardChange,
    BoardResult,
    EpisodeDifference,
    EpisodeResult,
    Evaluation,
    FreshList,
    LogCopy,
    NearCopy,
    SensorCheck,
    Shard,
    Trial,
)
from .judging import JudgingConflict, JudgingMark
from .notices import Notice, Webhook
from .operations import DeclaredEvaluator, LivePicture, MetricTotal, SchemaCompatibility, Station, Worker
from .people import Announcement, Appeal, AppealReplay, Question
from .playbacks import Playback
from .receipts import Cosignature, ReceiptKey, ReceiptRow, TreeNode
from .submissions import PartialUpload, Submission, SubmissionFile, UploadPart
from .work import Work

__all__ = [
    "ALL_TASKS",
    "ActionTrace",
    "Announcement",
    "ApiToken",
    "Appeal",
    "AppealReplay",
    "ArchiveCopy",
    "AuditEntry",
    "Base",
    "BoardChange",
    "BoardResult",
    "Brief",
    "CompetitionRow",
    "Cosignature",
    "DeclaredEvaluator",
    "EnteredResult",
    "EpisodeDifference",
    "EpisodeResult",
    "Evaluation",
    "FreshList",
    "HumanBaseline",
    "Invitation",
    "JudgingConflict",
    "JudgingMark",
    "LivePicture",
    "LogCopy",
    "Member",
    "MetricTotal",
    "NearCopy",
    "Notice",
    "PartialUpload",
    "Playback",
    "Qualification",
    "Question",
    "ReceiptKey",
    "ReceiptRow",
    "Rejudgement",
    "SchemaCompatibility",
    "SealedList",
    "SensorCheck",
    "Shard",
    "Station",
    "Submission",
    "SubmissionFile",
    "Team",
    "TeamQuota",
    "TreeNode",
    "Trial",
    "UploadPart",
    "Webhook",
    "Work",
    "Worker",
]
