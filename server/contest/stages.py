"""Which stage is open now, and who may submit to it; asked by whatever takes or shows submissions."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from types import MappingProxyType

from sqlalchemy import ColumnElement, and_, exists, func, or_, select
from sqlalchemy.orm import Session
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version

from ..db.competition_row import competition_row
from ..db.models import Evaluation, Qualification, Submission, Team
from ..db.states import ACTIVE_EVALUATION_STATES, EvaluationState
from ..db.stored_episodes import OF_EVALUATION
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..teams import teams
from ..tracks import known_track
from .definition import CompetitionDefinition, CompetitionTrack, Stage
from .sealing import list_of_stage

NO_STAGE = ""
"""Of submissions outside of a competition: to a track that has none, or for practice."""
_COUNTED: Mapping[str, frozenset[EvaluationState]] = MappingProxyType(
    {
        "scored_runs": frozenset({*ACTIVE_EVALUATION_STATES, EvaluationState.COMPLETED}),
        "attempts": frozenset(EvaluationState),
    }
)


def current(session: Session) -> CompetitionDefinition | None:
    """Return the competition of this service; None: none was applied."""
    row = competition_row(session)
    return CompetitionDefinition.model_validate(row.definition) if row else None


def stage_for_submission(
    session: Session, by: Principal, team: Team, *, track: str, kind: SubmissionKind, at: datetime | None = None
) -> str:
    """Return the stage to which a submission belongs; empty where its track is in no competition.

    Organizers submit also after the end, to the stage that opened last, for instance what reached them by mail in time.

    Args:
        session: of the transaction.
        by: who submits.
        team: whose submission it becomes.
        track: of the submission.
        kind: of the submission.
        at: when it is complete; None: now.

    Raises:
        ServiceError: no stage is open, it takes other kinds or qualified teams only, or the team does not take part.
    """
    teams.require_taking_part(team)
    found = track_rules(session, track)
    if found is None:
        return NO_STAGE
    now = at or datetime.now(UTC)
    stage = _open_stage(found, now) or (_last_opened(found, now) if by.is_organizer else None)
    if stage is None:
        raise ServiceError(ProblemCode.STAGE_CLOSED, f"{track} takes no submissions now: {_times(found, now)}.")
    sealed = list_of_stage(session, track, stage.name)
    if sealed is not None and sealed.revealed_at is not None:
        raise ServiceError(
            ProblemCode.STAGE_CLOSED, f"The episodes of stage {stage.name} of {track} are published; it is over."
        )
    if kind not in stage.accepts:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"Stage {stage.name} of {track} takes {', '.join(stage.accepts)}, got {kind}.",
            supported=list(stage.accepts),
        )
    if stage.qualified is not None and not is_qualified(session, team, track, stage.name):
        raise ServiceError(
            ProblemCode.NOT_QUALIFIED,
            f"Stage {stage.name} of {track} is for qualified teams: {stage.qualified.sentence}. {team.name} is not "
            "among those whom the organizers confirmed.",
        )
    return stage.name


def check_stage_quotas(session: Session, by: Principal, team: Team, *, track: str, stage: str) -> None:
    """Refuse one evaluation more than a stage allows; the team's row is locked by the caller.

    Raises:
        ServiceError: quota_exceeded, with the quota's name and limit.
    """
    competition = current(session) if stage and not by.is_organizer else None
    found = competition.stage(track, stage) if competition else None
    if found is None:
        return
    for quota, limit in found.quotas:
        if limit is not None and _used(session, team, track, stage, quota) >= limit:
            raise ServiceError(
                ProblemCode.QUOTA_EXCEEDED,
                f"The quota of {quota.replace('_', ' ')} in stage {stage} of {track} is {limit} for each team, and "
                f"{team.name} has used it up.",
                quota=f"stage_{quota}",
                limit=limit,
            )


@dataclass(frozen=True, kw_only=True)
class StageQuotaUse:
    """How much of a quota of an open stage a team has used; `limit` None: any number."""

    track: str
    stage: str
    closes: datetime
    quota: str
    limit: int | None
    used: int


def stage_quota_uses(session: Session, team: Team, at: datetime | None = None) -> list[StageQuotaUse]:
    """Return what a team may still have in each open stage that it takes part in; `at` None: now."""
    competition, now = current(session), at or datetime.now(UTC)
    tracks = competition.tracks.items() if competition else ()
    opened = [(name, _open_stage(track, now)) for name, track in tracks if track.taken_here]
    return [
        StageQuotaUse(
            track=track,
            stage=stage.name,
            closes=stage.closes,
            quota=quota,
            limit=limit,
            used=_used(session, team, track, stage.name, quota),
        )
        for track, stage in opened
        if stage is not None and (stage.qualified is None or is_qualified(session, team, track, stage.name))
        for quota, limit in stage.quotas
    ]


def is_qualified(session: Session, team: Team, track: str, stage: str) -> bool:
    """Return whether the organizers confirmed a team for a stage."""
    return session.get(Qualification, (track, stage, team.id)) is not None


def shown_stage(session: Session, track: str, wanted: str | None = None, *, at: datetime | None = None) -> str:
    """Return the stage whose board a track shows: the wanted one, else the one that opened last, else the first.

    Args:
        session: of the transaction.
        track: whose board.
        wanted: name of a stage; None: whichever is shown now.
        at: the moment; None: now.

    Returns:
        Its name, empty for a track without stages.

    Raises:
        ServiceError: there is no such stage.
    """
    found = track_rules(session, track)
    names = [stage.name for stage in found.stages] if found else []
    if wanted is not None:
        if wanted not in names:
            listed = f"its stages are {', '.join(names)}" if names else "it has none"
            raise ServiceError(ProblemCode.UNKNOWN_STAGE, f"{track} has no stage {wanted!r:.80}; {listed}.")
        return wanted
    if found is None:
        return NO_STAGE
    return (_last_opened(found, at or datetime.now(UTC)) or found.stages[0]).name


def track_rules(session: Session, track: str) -> CompetitionTrack | None:
    """Return what the competition says of a track; None: nothing, or its submissions are collected elsewhere."""
    competition = current(session)
    found = competition.tracks.get(track) if competition else None
    return found if found and found.taken_here else None


def track_title(session: Session, name: str) -> str:
    """Return what people call a track: in the competition, else by its file; its name where that is gone."""
    named = track_rules(session, name) or known_track(name)
    return named.title if named else name


def require_over(session: Session, track: str, stage: str) -> Stage:
    """Return a stage that has closed.

    Raises:
        ServiceError: there is no such stage, or it takes submissions still or later.
    """
    competition = current(session)
    found = competition.stage(track, stage) if competition else None
    if found is None:
        raise ServiceError(ProblemCode.UNKNOWN_STAGE, f"The competition has no stage {stage!r:.80} of {track!r:.80}.")
    if datetime.now(UTC) < found.closes:
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER, f"Stage {stage} of {track} closes at {found.closes:%F %T} UTC; wait until then."
        )
    return found


@dataclass(frozen=True, kw_only=True)
class CountedResults:
    """Which results the boards of a stage are made of.

    Attributes:
        evaluator_version: results of this one are ranked.
        frozen_at: later ones are not shown; None: boards are not frozen.
        final_since: later ones do not count; None: the competition goes on.
    """

    evaluator_version: str
    frozen_at: datetime | None = None
    final_since: datetime | None = None

    @property
    def until(self) -> datetime | None:
        """Return when results had to be complete; None: any time."""
        return self.frozen_at or self.final_since


def counted_results(session: Session, stage: str, *, live: bool = False) -> CountedResults:
    """Return which results count on the boards of a stage; once final, those of the version that was current then.

    Args:
        session: of the transaction.
        stage: of the competition; empty outside of one.
        live: for organizers: as if boards were not frozen.
    """
    row = competition_row(session) if stage else None
    if row is None:
        return CountedResults(evaluator_version=evaluator_version())
    return CountedResults(
        evaluator_version=row.boards[0]["evaluator_version"] if row.boards else evaluator_version(),
        frozen_at=None if live else row.frozen_at,
        final_since=row.finalized_at,
    )


def boards_stand_since(session: Session) -> datetime | None:
    """Return since when the boards of the competition are frozen; None: they are not."""
    row = competition_row(session)
    return row.frozen_at if row else None


def _used(session: Session, team: Team, track: str, stage: str, quota: str) -> int:
    counted: ColumnElement[bool] = Evaluation.state.in_(_COUNTED[quota])
    if quota == "scored_runs":  # what has seen a sealed list was worth a run, also where it was given up
        begun = exists().where(OF_EVALUATION).correlate(Evaluation, Submission)
        counted = or_(counted, and_(Evaluation.commitment.is_not(None), begun))
    query = (
        select(func.count())
        .select_from(Evaluation)
        .join(Submission)
        .where(
            Submission.team_id == team.id,
            Submission.track == track,
            Submission.stage == stage,
            Evaluation.charged_at.is_not(None),
            counted,
        )
    )
    return session.scalars(query).one()


def _open_stage(track: CompetitionTrack, now: datetime) -> Stage | None:
    return next((stage for stage in track.stages if stage.is_open(now)), None)


def _last_opened(track: CompetitionTrack, now: datetime) -> Stage | None:
    return next((stage for stage in reversed(track.stages) if stage.opens <= now), None)


def _times(track: CompetitionTrack, now: datetime) -> str:
    """Return what comes next, or what was last, for a message."""
    following = next((stage for stage in track.stages if now < stage.opens), None)
    if following is not None:
        return f"stage {following.name} opens at {following.opens:%F %T} UTC"
    return f"its last stage closed at {track.stages[-1].closes:%F %T} UTC"
