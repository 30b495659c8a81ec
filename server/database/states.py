"""Every status of the service as one enum with one table of allowed transitions; SQL triggers hold the same tables."""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class Role(StrEnum):
    """What a token may do."""

    TEAM = "team"  # its team's submissions
    JUDGE = "judge"  # reads all teams' submissions, changes nothing of theirs
    ORGANIZER = "organizer"  # everything


class MemberRole(StrEnum):
    """What a member may do in a team."""

    CAPTAIN = "captain"  # invites and removes members; each team has one
    MEMBER = "member"  # submits


class NoticeKind(StrEnum):
    """What a notice is about."""

    ACCEPTED = "accepted"  # a submission, which waits for its evaluation
    FINISHED = "finished"  # an evaluation with a score
    FAILED = "failed"  # an evaluation without one
    PROMOTED = "promoted"  # the team takes part in a further stage
    DEADLINE = "deadline"  # a stage closes soon
    ANNOUNCEMENT = "announcement"  # organizers say something to all teams
    CONFIRMATION = "confirmation"  # of a member's e-mail address, which gets nothing else before


class NoticeChannel(StrEnum):
    """How a notice is sent."""

    MAIL = "mail"
    WEBHOOK = "webhook"


class AppealState(StrEnum):
    """Life of an appeal."""

    OPEN = "open"  # no organizer has ruled on it
    UPHELD = "upheld"  # the team is right
    REJECTED = "rejected"  # the result stands
    WITHDRAWN = "withdrawn"  # taken back by the team


class FileRole(StrEnum):
    """What a stored file is to its submission, besides its upload."""

    SENSOR = "sensor"  # the sensor as it was made at the upload; only this is scored
    DOCUMENT = "document"  # the design document, as it was brought
    COEFFICIENTS = "coefficients"  # what the standard estimator learned of the sensor
    VIDEO = "video"  # of a trial on a station
    FIGURES = "figures"  # the part of the sensor's figures that one shard has measured


class Quota(StrEnum):
    """What a team may have so much of."""

    SCORED_RUNS_PER_DAY = "scored_runs_per_day"  # evaluations of a day that end, or may still end, with a score
    ATTEMPTS_PER_DAY = "attempts_per_day"  # evaluations of a day, however they end
    QUEUED_AT_ONCE = "queued_at_once"  # evaluations that wait or run
    TOKENS = "tokens"  # valid tokens
    EVENT_STREAMS = "event_streams"  # open event streams, of API and pages together
    STORED_MIB = "stored_mib"  # stored uploads, and those being sent


class EvaluationState(StrEnum):
    """Life of one evaluation."""

    QUEUED = "queued"  # no shard has started
    RUNNING = "running"  # a shard has started
    COMPLETED = "completed"  # all records are there and scored
    FAILED = "failed"  # ended without a score; the verdict says why
    CANCELLED = "cancelled"  # ended by the team or an organizer


class WorkKind(StrEnum):
    """What a piece of work is; `server.queue.kinds` declares what follows from it."""

    SENSOR_CHECK = "sensor_check"  # makes the sensor of a submission, before its evaluation
    REPLAY = "replay"  # plays an episode again for an appeal
    PLAYBACK = "playback"  # makes the files that the page of an episode plays
    TRIAL = "trial"  # a shard that a station plays on its platform
    SHARD = "shard"  # plays a piece of an evaluation's list, or verifies one of a log's


class WorkState(StrEnum):
    """Life of a piece of work."""

    QUEUED = "queued"  # waits for a worker
    RUNNING = "running"  # leased to a worker
    DONE = "done"  # its result is stored
    FAILED = "failed"  # there is no result: the policy, the sensor, the log or the machines failed
    CANCELLED = "cancelled"  # nobody needs it any longer


class RepeatCause(StrEnum):
    """What ended an attempt at a piece of work before its result."""

    BROKE = "broke"  # the machine could not do it
    LOST = "lost"  # the worker did not renew its lease: it was killed, or its machine is gone


class WorkerState(StrEnum):
    """What a worker process last said about itself."""

    READY = "ready"  # takes shards
    REFUSING = "refusing"  # its sandbox lets things through, so it takes nothing; the message says what
    STOPPED = "stopped"  # ended in order
    CORDONED = "cordoned"  # takes no new shards, because an organizer asked; ends after its last one when drained


class WorkerOrder(StrEnum):
    """What an organizer has asked a worker to do."""

    WORK = "work"  # take shards
    CORDON = "cordon"  # take no new shards
    DRAIN = "drain"  # take no new shards, and end after the last one


EVALUATION_TRANSITIONS: Mapping[EvaluationState, frozenset[EvaluationState]] = MappingProxyType(
    {
        EvaluationState.QUEUED: frozenset({EvaluationState.RUNNING, EvaluationState.FAILED, EvaluationState.CANCELLED}),
        EvaluationState.RUNNING: frozenset(
            {EvaluationState.COMPLETED, EvaluationState.FAILED, EvaluationState.CANCELLED}
        ),
        EvaluationState.COMPLETED: frozenset(),
        EvaluationState.FAILED: frozenset(),
        EvaluationState.CANCELLED: frozenset(),
    }
)

WORK_TRANSITIONS: Mapping[WorkState, frozenset[WorkState]] = MappingProxyType(
    {
        WorkState.QUEUED: frozenset({WorkState.RUNNING, WorkState.FAILED, WorkState.CANCELLED}),
        # Back to queued: the worker gave it back or did not renew its lease in time.
        WorkState.RUNNING: frozenset({WorkState.QUEUED, WorkState.DONE, WorkState.FAILED, WorkState.CANCELLED}),
        WorkState.DONE: frozenset(),
        WorkState.FAILED: frozenset(),
        WorkState.CANCELLED: frozenset(),
    }
)

TERMINAL_EVALUATION_STATES = frozenset(state for state, following in EVALUATION_TRANSITIONS.items() if not following)
ACTIVE_EVALUATION_STATES = frozenset(EvaluationState) - TERMINAL_EVALUATION_STATES
OPEN_WORK_STATES = frozenset(state for state, following in WORK_TRANSITIONS.items() if following)
