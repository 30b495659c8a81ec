"""The queue of work: its kinds with priority and share, and how workers claim, renew and finish it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial
from types import MappingProxyType
from typing import Any
from uuid import UUID

import structlog
from sqlalchemy import Interval, cast, func, select, text, update
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.errors import VitacError
from vitac.evaluator.isolation_kinds import IsolationKind

from ..database.clock import read_clock
from ..database.engine import Database
from ..database.locks import AdvisoryLock, try_lock, unless_held, wait_for_turn
from ..database.models import Work
from ..database.states import OPEN_WORK_STATES, RepeatCause, WorkKind, WorkState
from ..settings import Settings
from ..views.evaluations import RepeatView

logger = structlog.get_logger(__name__)


CHANNEL = "vitac_work"
"""On which the database tells workers that something waits."""


UNPLANNED = " unplanned"
"""At the end of what a trial requires that waits for its plan: no worker has it."""
_AT = " at "


SHARED_OVER_S = 300.0
"""Time over which shares are measured [s]."""


RETRY_DELAY_S = 2.0
"""Pause before the second attempt of work that a machine could not do; the third comes after twice as long."""
_GROWTH, _LONGEST_DELAY_S = 1.5, 600.0
"""Later pauses grow, so that a station which is out of order for an hour ends no evaluation."""


IDLE_LIMIT = "10s"
"""The database ends a sweep whose process does nothing for this time, and another one takes over."""
_CLAIM = text("""
    UPDATE work
    SET state = 'running', token = token + 1, attempts = attempts + 1, worker_id = :worker,
        started_at = clock_timestamp(), progressed_at = clock_timestamp(),
        lease_expires_at = clock_timestamp() + CAST(:lease AS interval)
    WHERE id = (
        SELECT id FROM work waiting
        WHERE state = 'queued' AND kind = ANY(:kinds) AND requires = ANY(:abilities) AND not_before <= clock_timestamp()
            AND NOT (kind = ANY(:one_per_owner) AND EXISTS (
                SELECT FROM work same
                WHERE same.state = 'running' AND same.kind = waiting.kind AND same.owner = waiting.owner
            ))
            AND NOT (kind = 'shard' AND EXISTS (
                SELECT FROM work beside
                WHERE beside.state = 'running' AND beside.kind = 'shard' AND beside.owner = waiting.owner
                    AND (beside.requires LIKE '% sealed') <> (waiting.requires LIKE '% sealed')
            ))
            AND NOT (kind = 'trial' AND waiting.requires LIKE '% at %' AND EXISTS (
                SELECT FROM work before
                WHERE before.state IN ('queued', 'running') AND before.kind = 'trial'
                    AND before.requires = waiting.requires AND before.turn < waiting.turn
            ))
        ORDER BY priority, token = 0, turn, id
        LIMIT 1 FOR UPDATE SKIP LOCKED
    )
    RETURNING id, kind, owner, token, attempts, CAST(extract(epoch FROM started_at - queued_at) AS double precision)
""")
_HAS_BESIDE = text("""
    SELECT EXISTS (
        SELECT FROM work taken JOIN work beside ON beside.kind = 'shard' AND beside.owner = taken.owner
        WHERE taken.id = :id AND beside.state = 'running'
            AND (beside.requires LIKE '% sealed') <> (taken.requires LIKE '% sealed')
    )
""")
"""Whether a team's shard was taken at the same moment as one of the other kind of list."""
_OVER_SHARE = text("""
    SELECT shared.kind
    FROM unnest(CAST(:kinds AS text[]), CAST(:shares AS double precision[]), CAST(:limits AS double precision[]))
        shared (kind, share, limit_s)
    WHERE (
        SELECT sum(extract(
            epoch FROM coalesce(finished_at, now()) - greatest(started_at, now() - CAST(:over AS interval))
        ))
        FROM work
        WHERE work.kind = shared.kind AND started_at > now() - CAST(:over AS interval) - limit_s * interval '1 s'
            AND (state = 'running' OR finished_at > now() - CAST(:over AS interval))
    ) > share * extract(epoch FROM CAST(:over AS interval)) * (
        SELECT greatest(coalesce(sum(slots), 0), 1) FROM workers
        WHERE state = 'ready' AND heartbeat_at > now() - CAST(:lost_after AS interval)
    )
""")
"""Kinds that took more than their share of the slots' time; `now()`, as one moment serves all."""


class LeaseLost(VitacError):
    """The work belongs to another worker or was ended from outside: stop working on it and report nothing."""


class _TakenBeside(VitacError):
    """The claim is taken back: a team's sealed and public shards do not run at the same time."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """The right to do one piece of work.

    Attributes:
        attempt: which one since it last progressed, from 1.
        waited_s: how long it was queued [s].
    """

    work_id: int
    kind: WorkKind
    token: int
    attempt: int
    waited_s: float


GiveUp = Callable[[Session, Claim, str], None]
"""Ends work that was tried in all its attempts; the text says what became of them."""


def name_requirement(
    evaluator_version: str,
    family: Family = Family.TACTILE,
    *,
    sealed: bool = False,
    isolation: IsolationKind | None = None,
    needs_gpu: bool = False,
) -> str:
    """Return what a worker must have for work on a task.

    Args:
        evaluator_version: that it must have.
        family: of the task, whose needs it must meet.
        sealed: whether a policy plays a sealed list, so that its sandbox must leave no traces in the machine's caches.
        isolation: that its stage asks for; every worker has namespaces.
        needs_gpu: whether a policy plays that needs one.
    """
    own_kernel = f" {isolation}" if isolation is IsolationKind.VM else ""
    return f"{evaluator_version} {family}{own_kernel}{' gpu' if needs_gpu else ''}{' sealed' if sealed else ''}"


def at_station(requirement: str, station: str) -> str:
    """Return the requirement of a trial for which its plan names a station."""
    return f"{requirement.removesuffix(UNPLANNED)}{_AT}{station}"


def find_station(requirement: str) -> str:
    """Return the station that a plan named for a trial."""
    return requirement.partition(_AT)[2]


def waiting(session: Session, kind: WorkKind, *, owner: str, requires: str, turn: int | None = None) -> dict[str, Any]:
    """Return the columns of a new piece of work that waits.

    Args:
        session: of the transaction that adds it.
        kind: of the work.
        owner: who shares the workers with others of its kind.
        requires: from `name_requirement`.
        turn: its turn; None: the owner's next one.
    """
    return {
        "owner": owner,
        "requires": requires,
        "priority": KINDS[kind].priority,
        "turn": next_turn(session, [kind], owner) if turn is None else turn,
        "state": WorkState.QUEUED,
    }


def next_turn(session: Session, kinds: Collection[WorkKind], owner: str) -> int:
    """Return the turn of an owner's new work: lower ones go first, of equal ones the earlier.

    It comes one after the owner's last turn, but not before the turn that is running: who was away has saved nothing
    up, and who waits is not overtaken for ever. These are the start tags of start-time fair queueing with work of equal
    cost: P. Goyal, H. M. Vin and H. Cheng, Start-time fair queuing, IEEE/ACM Transactions on Networking 5 (1997)
    690-704, section 2.
    """
    running, first_waiting, last_of_owner = session.execute(
        select(
            func.max(Work.turn).filter(Work.state == WorkState.RUNNING),
            func.min(Work.turn).filter(Work.state == WorkState.QUEUED),
            func.max(Work.turn).filter(Work.owner == owner),
        ).where(Work.kind.in_(kinds), Work.state.in_(OPEN_WORK_STATES))
    ).one()
    now = next((turn for turn in (running, first_waiting) if turn is not None), 0)
    return now if last_of_owner is None else max(now, last_of_owner + 1)


def claim(
    database: Database,
    settings: Settings,
    worker_id: UUID,
    abilities: Collection[str],
    over_share: Collection[WorkKind] = (),
) -> Claim | None:
    """Take the next piece of work for a worker, in a transaction of its own; None where nothing waits that it can do.

    A team's shards of sealed lists never run beside its public ones, whose episodes it sees: sandboxes that run at the
    same time could talk.

    Args:
        database: of the service.
        settings: of the service.
        worker_id: who takes it.
        abilities: what the worker has, from `name_requirement`.
        over_share: kinds that have taken their share, from `list_over_share`.
    """
    for kinds in ([kind for kind in KINDS if kind not in over_share], list(over_share)):
        values = {
            "worker": worker_id,
            "lease": timedelta(seconds=settings.lease_s),
            "kinds": kinds,
            "abilities": list(abilities),
            "one_per_owner": [kind for kind in kinds if KINDS[kind].one_per_owner],
        }
        try:
            with database.transaction() as session:
                row = session.execute(_CLAIM, values).one_or_none() if kinds else None
                if row is not None and row.kind == WorkKind.SHARD:
                    wait_for_turn(session, AdvisoryLock.LISTS_OF_TEAM, row.owner)
                    if session.scalar(_HAS_BESIDE, {"id": row.id}):
                        raise _TakenBeside
        except (IntegrityError, _TakenBeside):  # another worker has taken the place of this owner at the same moment
            return None
        if row is not None:
            work_id, kind, _, token, attempts, waited_s = row
            return Claim(work_id=work_id, kind=WorkKind(kind), token=token, attempt=attempts, waited_s=waited_s)
    return None


def list_over_share(session: Session, settings: Settings) -> list[WorkKind]:
    """Return the kinds that have taken their share of the slots' time in the last minutes."""
    shared = {kind: one for kind, one in KINDS.items() if one.share is not None}
    values = {
        "kinds": list(shared),
        "shares": [one.share for one in shared.values()],
        "limits": [one.limit_s or 0.0 for one in shared.values()],
        "over": timedelta(seconds=SHARED_OVER_S),
        "lost_after": timedelta(seconds=settings.worker_lost_after_s),
    }
    return [WorkKind(kind) for kind in session.scalars(_OVER_SHARE, values)]


def renew(session: Session, claim: Claim, lease_s: float) -> None:
    """Keep the work for another while, but no longer than an attempt may take.

    Raises:
        LeaseLost: it is no longer ours, for example because it was cancelled.
    """
    end = func.clock_timestamp() + _interval(lease_s)
    limit_s = KINDS[claim.kind].limit_s
    if limit_s is not None:
        end = func.least(end, Work.started_at + _interval(limit_s + lease_s))
    change_held(session, claim, lease_expires_at=end)


def lock_held(session: Session, claim: Claim) -> int:
    """Keep others from ending the lease until the end of the transaction; return the attempts without progress.

    Raises:
        LeaseLost: the work is no longer ours.
    """
    attempts = session.scalar(select(Work.attempts).where(*_held(claim)).with_for_update())
    if attempts is None:
        raise lost(claim)
    return attempts


def note_progress(session: Session, claim: Claim) -> None:
    """Note that the work has got further now; attempts are counted from zero again, this one included.

    Raises:
        LeaseLost: the work is no longer ours.
    """
    change_held(session, claim, attempts=0, progressed_at=func.clock_timestamp())


def end(session: Session, claim: Claim, state: WorkState, *, problem: str | None = None) -> None:
    """Mark the work as done, or as failed for a reason.

    Raises:
        LeaseLost: it is no longer ours.
    """
    change_held(session, claim, state=state, problem=problem, lease_expires_at=None, finished_at=func.clock_timestamp())


def hand_back(session: Session, claim: Claim, *, delay_s: float = 0.0) -> None:
    """Queue the work again for the next free worker (after a while); this was no attempt.

    Raises:
        LeaseLost: the work is no longer ours.
    """
    _queue_again(session, claim, attempts=func.greatest(Work.attempts - 1, 0), delay_s=delay_s)


def report_broken(
    session: Session, settings: Settings, claim: Claim, message: str, *, give_up: GiveUp, is_free: bool = True
) -> None:
    """Queue work again that this machine could not do; after the last attempt, give it up.

    Attempts in which it progressed do not count: machines end nothing as long as it moves.

    Args:
        session: of the database.
        settings: of the service.
        claim: of the work.
        message: what happened.
        give_up: ends what the work belongs to.
        is_free: whether it was the machine alone, so that the attempt is free where such ones are.

    Raises:
        LeaseLost: the work is no longer ours.
    """
    work = session.execute(select(Work.attempts, Work.repeats).where(*_held(claim))).one_or_none()
    if work is None:
        raise lost(claim)
    attempts = _count_attempts(claim.kind, *work) if is_free else work.attempts
    if attempts >= settings.shard_attempts:
        give_up(session, claim, f"Tried {attempts} times without progress. The last time: {message}")
        return
    delay_s = _retry_delay_s(attempts, len(work.repeats))
    _queue_again(session, claim, attempts=attempts, delay_s=delay_s, repeat=(RepeatCause.BROKE, message))


def _retry_delay_s(attempts: int, repeats: int) -> float:
    """Return the pause [s] before the next attempt, after these that counted and this often queued again before."""
    return min(RETRY_DELAY_S * max(attempts, _GROWTH**repeats), _LONGEST_DELAY_S)


def _queue_again(
    session: Session,
    claim: Claim,
    *,
    attempts: Any,
    delay_s: float = 0.0,
    repeat: tuple[RepeatCause, str] | None = None,
) -> None:
    noted = []
    if repeat is not None:
        noted = [RepeatView(at=read_clock(session), cause=repeat[0], reason=repeat[1]).model_dump(mode="json")]
    change_held(
        session,
        claim,
        state=WorkState.QUEUED,
        attempts=attempts,
        repeats=Work.repeats.concat(cast(noted, JSONB)),
        lease_expires_at=None,
        worker_id=None,
        queued_at=func.clock_timestamp(),
        not_before=func.clock_timestamp() + _interval(delay_s),
    )


def _count_attempts(kind: WorkKind, attempts: int, repeats: Sequence[object]) -> int:
    """Return the attempts that count, without the one that just ended if such ones are still free."""
    return attempts if len(repeats) >= KINDS[kind].free_repeats else max(attempts - 1, 0)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What one sweep did, as numbers of pieces of work."""

    queued_again: int = 0
    given_up: int = 0


def sweep(session: Session, settings: Settings, *, give_up: GiveUp) -> Sweep:
    """Queue work again whose worker did not renew its lease; give up what was lost in all its attempts.

    Every worker does it all the time, and of each server one process. A process that stands still in the middle of a
    transaction holds its locks: the sweep passes over what it holds, and loses its own if it stands still itself.
    """
    if not try_lock(session, AdvisoryLock.SWEEP):
        return Sweep()
    session.execute(text(f"SET LOCAL idle_in_transaction_session_timeout = '{IDLE_LIMIT}'"))
    # After a restart of the database every worker gets a full lease of time to renew again: it could not meanwhile.
    server_is_up = func.pg_postmaster_start_time() < func.clock_timestamp() - _interval(settings.lease_s)
    is_lost = (Work.state == WorkState.RUNNING, Work.lease_expires_at < func.clock_timestamp(), server_is_up)
    columns = (Work.id, Work.kind, Work.token, Work.attempts, Work.worker_id, Work.repeats)
    rows = session.execute(select(*columns).where(*is_lost).order_by(Work.id)).all()
    ends = []
    for work_id, kind, token, attempts, worker_id, repeats in rows:
        of_lost = Claim(work_id=work_id, kind=kind, token=token, attempt=attempts, waited_s=0.0)
        recover = partial(
            _recover, session, settings, of_lost, _count_attempts(kind, attempts, repeats), worker_id, give_up
        )
        ends.append(unless_held(session, recover))
    return Sweep(queued_again=ends.count(True), given_up=ends.count(False))


def _recover(
    session: Session, settings: Settings, claim: Claim, attempts: int, worker_id: UUID | None, give_up: GiveUp
) -> bool | None:
    """Queue lost work again, or give it up; whether the first, None where it is not lost after all."""
    names = {"work": claim.work_id, "kind": str(claim.kind), "worker": str(worker_id), "attempts": attempts}
    try:
        if attempts >= settings.shard_attempts:
            give_up(
                session, claim, f"Started {attempts} times, and each time the worker was lost before it progressed."
            )
            logger.error("work_given_up", **names)
            return False
        repeat = (RepeatCause.LOST, f"The worker {worker_id} was lost.")
        _queue_again(session, claim, attempts=attempts, repeat=repeat)
    except LeaseLost:
        return None
    logger.warning("work_lost", **names)
    return True


def count_open(session: Session) -> int:
    """Return how many pieces of work wait or run; what starts and ends machines asks."""
    return session.scalars(select(func.count()).select_from(Work).where(Work.state.in_(OPEN_WORK_STATES))).one()


def change_held(session: Session, claim: Claim, **values: Any) -> None:
    """Change columns of the work's row, of which its kind's table has none.

    Raises:
        LeaseLost: the work is no longer ours.
    """
    changed = session.scalar(
        update(Work)
        .where(*_held(claim))
        .values(**values)
        .returning(Work.id)
        .execution_options(synchronize_session=False)
    )
    if changed is None:
        raise lost(claim)


def _held(claim: Claim) -> Sequence[Any]:
    return (Work.id == claim.work_id, Work.token == claim.token, Work.state == WorkState.RUNNING)


def _interval(seconds: float) -> Any:
    return cast(timedelta(seconds=seconds), Interval)


def lost(claim: Claim) -> LeaseLost:
    """Return the refusal of whoever no longer holds a piece of work."""
    return LeaseLost(f"The {claim.kind} {claim.work_id} is no longer held under token {claim.token}.")


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How work of a kind is shared out, and what it may take.

    Attributes:
        priority: the lowest of what waits goes first.
        share: part of the time of all slots up to which it goes by its priority; what is over its share goes after
            all others. None: without limit.
        one_per_owner: whether only one piece of an owner runs at a time (`uq_work_place` holds it).
        limit_s: time of one attempt [s]; None: as long as it progresses.
        free_repeats: how many attempts do not count that a lost worker or a broken machine ended.
    """

    priority: int
    share: float | None = None
    one_per_owner: bool = False
    limit_s: float | None = None
    free_repeats: int = 0


KINDS: Mapping[WorkKind, Kind] = MappingProxyType(
    {
        WorkKind.SENSOR_CHECK: Kind(priority=1, share=0.25, one_per_owner=True, limit_s=60.0),
        WorkKind.REPLAY: Kind(priority=2, share=0.1, limit_s=1800.0),
        WorkKind.PLAYBACK: Kind(priority=3, share=0.25, limit_s=600.0),
        # A killed agent or a device with a fault says nothing about the policy.
        WorkKind.TRIAL: Kind(priority=4, free_repeats=20),
        WorkKind.SHARD: Kind(priority=5),
    }
)
"""Every kind. Short work that people wait for goes first, within its share; evaluations have the rest, at least 0.4."""
