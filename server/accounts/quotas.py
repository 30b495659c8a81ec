"""Quotas of teams, a day and in a stage: what is counted, how much of it is used, the refusal that names the quota.

Counted is what a team itself asks for (`Evaluation.charged_at`). What organizers start and what machines failed costs
nothing. Called by whatever gives a team something that is counted.
"""

from collections.abc import Mapping
from datetime import datetime, timedelta
from types import MappingProxyType
from uuid import UUID

from sqlalchemy import ColumnElement, Select, and_, delete, exists, func, or_, select, union
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..audit import record
from ..competitions.competition import Competition
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import ApiToken, Evaluation, PartialUpload, Submission, SubmissionFile, Team, TeamQuota
from ..database.states import ACTIVE_EVALUATION_STATES, EvaluationState, FileRole, Quota
from ..database.stored_episodes import OF_EVALUATION
from ..database.stored_uploads import HAS_NO_UPLOAD
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..settings import Quotas
from ..views.teams import QuotaView, StageQuotaView
from . import teams

DAILY = frozenset({Quota.SCORED_RUNS_PER_DAY, Quota.ATTEMPTS_PER_DAY})
_UNITS: Mapping[Quota, str] = MappingProxyType(
    {
        Quota.SCORED_RUNS_PER_DAY: "evaluations a day (UTC) that end with a score or may still do so",
        Quota.ATTEMPTS_PER_DAY: "evaluations a day (UTC), however they end",
        Quota.QUEUED_AT_ONCE: "evaluations that wait or run",
        Quota.STORED_MIB: "MiB of stored uploads",
        Quota.TOKENS: "valid tokens",
        Quota.EVENT_STREAMS: "event streams at the same time",
    }
)
_OPENING: Mapping[Quota, str] = MappingProxyType(
    {
        Quota.QUEUED_AT_ONCE: "when one of them ends; cancelling one helps",
        Quota.STORED_MIB: "a day after an evaluation was cancelled; deleting an unfinished upload helps",
        Quota.TOKENS: "when one is revoked or expires",
        Quota.EVENT_STREAMS: "when one of them is closed",
    }
)
_COUNTED_IN_STAGE: Mapping[str, frozenset[EvaluationState]] = MappingProxyType(
    {
        "scored_runs": frozenset({*ACTIVE_EVALUATION_STATES, EvaluationState.COMPLETED}),
        "attempts": frozenset(EvaluationState),
    }
)


def find_limits(session: Session, quotas: Quotas, team_id: UUID) -> dict[Quota, int | None]:
    """Return a team's limits: its own, else those of the settings; None: any number."""
    own = session.scalars(select(TeamQuota).where(TeamQuota.team_id == team_id))
    return {quota: getattr(quotas, quota.value) for quota in Quota} | {each.quota: each.most for each in own}


def charge(session: Session, quotas: Quotas, by: Principal, team: Team, *wanted: Quota) -> datetime | None:
    """Refuse one thing more than the quotas allow; of several at once the next sees what the one before has taken.

    Returns:
        When it was charged; None: an organizer asked for it, so it costs nothing.

    Raises:
        ServiceError: quota_exceeded, with the quota's name, its limit, and when it opens again.
    """
    if by.organizes_service:
        return None
    teams.lock(session, team)
    check(session, quotas, by, team, *wanted)
    return read_clock(session)


def check(session: Session, quotas: Quotas, by: Principal, team: Team, *wanted: Quota) -> None:
    """Refuse as `charge` does, without holding up anybody: to say no before a large upload.

    Raises:
        ServiceError: quota_exceeded.
    """
    if by.organizes_service:
        return
    limits, now = find_limits(session, quotas, team.id), read_clock(session)
    for quota in wanted:
        limit = limits[quota]
        if limit is not None and (_used(session, team.id, quota, now) or 0) >= limit:
            raise exceeded(team.name, quota, limit, now)


def check_stage(session: Session, by: Principal, team: Team, stage: Stage) -> None:
    """Refuse one evaluation more than a stage allows; the team's row is locked by the caller.

    Raises:
        ServiceError: quota_exceeded, with the quota's name and limit.
    """
    if by.organizes_service:
        return
    for quota, limit in stage.quotas:
        if limit is not None and _used_in_stage(session, team, stage, quota) >= limit:
            raise ServiceError(
                ProblemCode.QUOTA_EXCEEDED,
                f"The quota of {quota.replace('_', ' ')} in {stage} is {limit} for each team, and {team.name} has used "
                "it up.",
                quota=f"stage_{quota}",
                limit=limit,
            )


def exceeded(team: str, quota: Quota, limit: int, now: datetime | None = None) -> ServiceError:
    """Return the refusal of one thing more; of what is counted by day `now` says when there is room again."""
    opens_at = None if now is None else _find_opening(quota, now)
    times: dict[str, object] = {}
    if opens_at is not None and now is not None:
        times = {"opens_at": opens_at.isoformat(), "retry_after_s": max(1, round((opens_at - now).total_seconds()))}
    opening = f"at {opens_at:%F %H:%M} UTC" if opens_at is not None else _OPENING[quota]
    return ServiceError(
        ProblemCode.QUOTA_EXCEEDED,
        f"{team} may have {limit} {_UNITS[quota]} and has used up quota {quota.value}. There is room again {opening}.",
        quota=quota.value,
        limit=limit,
        **times,
    )


def uses(session: Session, quotas: Quotas, team_id: UUID) -> list[QuotaView]:
    """Return all quotas of a team."""
    now = read_clock(session)
    return [
        QuotaView(
            quota=quota, limit=limit, used=_used(session, team_id, quota, now), opens_at=_find_opening(quota, now)
        )
        for quota, limit in find_limits(session, quotas, team_id).items()
    ]


def stage_uses(session: Session, team: Team, at: datetime | None = None) -> list[StageQuotaView]:
    """Return what a team may still have in each open stage that it takes part in; `at` None: now."""
    now = at or read_clock(session)
    return [
        StageQuotaView(
            competition=competition.name,
            track=stage.track,
            stage=stage.name,
            closes=stage.rules.closes,
            quota=quota,
            limit=limit,
            used=_used_in_stage(session, team, stage, quota),
        )
        for competition in Competition.read_all(session)
        for stage in competition.stages
        if stage.is_open(now) and stage.may_submit(team)
        for quota, limit in stage.quotas
    ]


def set_quota(session: Session, by: Principal, team: Team, quota: Quota, limit: int | None) -> None:
    """Give a team a limit of its own; None: any number.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    before = _noted(session, team, quota)
    values = {"team_id": team.id, "quota": quota, "most": limit}
    added = insert(TeamQuota).values(**values)
    session.execute(added.on_conflict_do_update(constraint="pk_team_quotas", set_={"most": limit}))
    after = {"quota": quota.value, "limit": limit}
    record(session, by, "team.quota", f"team:{team.id}", after, before=before)


def reset_quota(session: Session, by: Principal, team: Team, quota: Quota) -> None:
    """Let the settings' limit hold for a team again.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    before = _noted(session, team, quota)
    session.execute(delete(TeamQuota).where(TeamQuota.team_id == team.id, TeamQuota.quota == quota))
    after = {"quota": quota.value, "limit": "default"}
    record(session, by, "team.quota", f"team:{team.id}", after, before=before)


def _noted(session: Session, team: Team, quota: Quota) -> dict[str, object]:
    """Return a team's own limit as the audit log has it."""
    own = session.get(TeamQuota, (team.id, quota), populate_existing=True)
    return {"quota": quota.value, "limit": "default" if own is None else own.most}


def _used(session: Session, team_id: UUID, quota: Quota, now: datetime) -> int | None:
    if quota is Quota.EVENT_STREAMS:
        return None
    if quota is Quota.STORED_MIB:
        return -(-_stored_bytes(session, team_id, now) // (1 << 20))
    query = _tokens(team_id, now) if quota is Quota.TOKENS else _evaluations(team_id, quota, now)
    return session.scalars(query).one()


def _stored_bytes(session: Session, team_id: UUID, now: datetime) -> int:
    """Return the size of a team's stored files, each once, and of its uploads that are not complete."""
    own = Submission.team_id == team_id, ~HAS_NO_UPLOAD
    uploads = select(Submission.archive_sha256, Submission.archive_bytes).where(*own)
    others = select(SubmissionFile.sha256, SubmissionFile.n_bytes).join(
        Submission, Submission.id == SubmissionFile.submission_id
    )
    others = others.where(SubmissionFile.role != FileRole.VIDEO)  # which the station has made
    stored = union(uploads, others.where(*own)).subquery()
    unfinished = select(func.sum(PartialUpload.total_bytes)).where(
        PartialUpload.team_id == team_id,
        PartialUpload.submission_id.is_(None),
        PartialUpload.expires_at > now,
    )
    return int(session.scalar(select(func.sum(stored.c[1]))) or 0) + int(session.scalar(unfinished) or 0)


def _tokens(team_id: UUID, now: datetime) -> Select[int]:
    is_good = ApiToken.revoked_at.is_(None) & or_(ApiToken.expires_at.is_(None), ApiToken.expires_at > now)
    return select(func.count()).select_from(ApiToken).where(ApiToken.team_id == team_id, ~ApiToken.is_session, is_good)


def _select_counted_evaluations(team_id: UUID) -> Select[int]:
    return select(func.count()).select_from(Evaluation).join(Submission).where(Submission.team_id == team_id)


def _evaluations(team_id: UUID, quota: Quota, now: datetime) -> Select[int]:
    query = _select_counted_evaluations(team_id)
    if quota is Quota.QUEUED_AT_ONCE:
        return query.where(Evaluation.state.in_(ACTIVE_EVALUATION_STATES), Evaluation.charged_at.is_not(None))
    today = query.where(Evaluation.charged_at >= _day_start(now))
    if quota is Quota.SCORED_RUNS_PER_DAY:
        return today.where(Evaluation.state.in_({*ACTIVE_EVALUATION_STATES, EvaluationState.COMPLETED}))
    return today


def _used_in_stage(session: Session, team: Team, stage: Stage, quota: str) -> int:
    counted: ColumnElement[bool] = Evaluation.state.in_(_COUNTED_IN_STAGE[quota])
    if quota == "scored_runs":  # what has seen a sealed list was worth a run, also where it was given up
        begun = exists().where(OF_EVALUATION).correlate(Evaluation, Submission)
        counted = or_(counted, and_(Evaluation.commitment.is_not(None), begun))
    of_team = _select_counted_evaluations(team.id).where(stage.submissions, Evaluation.charged_at.is_not(None), counted)
    return session.scalars(of_team).one()


def _find_opening(quota: Quota, now: datetime) -> datetime | None:
    return _day_start(now) + timedelta(days=1) if quota in DAILY else None


def _day_start(now: datetime) -> datetime:
    return now.replace(hour=0, minute=0, second=0, microsecond=0)
