"""Makes the view of the competition; called by API and pages."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from ..db.competition_row import competition_row
from ..db.models import SealedList, Submission, Team
from ..errors import ProblemCode, ServiceError
from ..views.contest import (
    CompetitionTrackView,
    CompetitionView,
    DisqualifiedTeamView,
    PrizeView,
    StageView,
    WinnerView,
)
from .definition import CompetitionDefinition, CompetitionTrack, Stage
from .sealing import sealed_lists
from .stages import track_rules

Lists = Mapping[tuple[str, str], SealedList]


def competition_view(session: Session, at: datetime | None = None) -> CompetitionView:
    """Return the competition; `at` is the moment, None: now.

    Raises:
        ServiceError: this service runs none.
    """
    row = competition_row(session)
    if row is None:
        raise ServiceError(ProblemCode.NOT_FOUND, "This service runs no competition; all its tracks are for practice.")
    found, now = CompetitionDefinition.model_validate(row.definition), at or datetime.now(UTC)
    lists = _lists(session)
    return CompetitionView(
        name=found.name,
        title=found.title,
        summary=found.summary,
        website=found.website,
        contact=found.contact,
        rules=list(found.rules),
        currency=found.currency,
        teams_locked=found.teams_locked,
        anonymous=found.anonymous,
        appeal_days=found.appeal_days,
        tracks=[_track(name, track, lists, now) for name, track in found.tracks.items()],
        frozen_at=row.frozen_at,
        finalized_at=row.finalized_at,
        winners=[WinnerView.model_validate(winner, extra="ignore") for winner in row.winners or []],
        disqualified=disqualified_since_the_end(session),
    )


def disqualified_since_the_end(session: Session) -> list[DisqualifiedTeamView]:
    """Return the teams among the kept winners and boards that were disqualified later; none before the end."""
    row = competition_row(session)
    if row is None or row.finalized_at is None:
        return []
    kept = {winner["submission"]: winner["team"] for winner in row.winners or ()}
    kept |= {entry["submission_id"]: entry["team"] for board in row.boards or () for entry in board["entries"]}
    query = select(Submission.id, Team.disqualified_at).join(Submission.team).where(Team.disqualified_at.is_not(None))
    since = {kept[str(submission)]: at for submission, at in session.execute(query) if at and str(submission) in kept}
    return [DisqualifiedTeamView(team=team, disqualified_at=at) for team, at in sorted(since.items())]


def track_stages(session: Session, track: str, at: datetime | None = None) -> Sequence[StageView]:
    """Return the stages of a track that is held here; empty outside of a competition. `at` None: now."""
    rules = track_rules(session, track)
    if rules is None:
        return ()
    lists, now = _lists(session), at or datetime.now(UTC)
    return [_stage(stage, rules, lists.get((track, stage.name)), now) for stage in rules.stages]


def _lists(session: Session) -> Lists:
    return {(each.track, each.stage): each for each in sealed_lists(session)}


def _track(name: str, track: CompetitionTrack, lists: Lists, now: datetime) -> CompetitionTrackView:
    return CompetitionTrackView(
        name=name,
        title=track.title,
        taken_here=track.taken_here,
        ranking=list(track.ranking),
        ties=track.ties,
        stages=[_stage(stage, track, lists.get((name, stage.name)), now) for stage in track.stages],
        prizes=[PrizeView(**prize.model_dump()) for prize in track.prizes],
        judging=track.judging.sentence if track.judging else None,
    )


def _stage(stage: Stage, track: CompetitionTrack, sealed: SealedList | None, now: datetime) -> StageView:
    return StageView(
        name=stage.name,
        title=stage.title,
        opens=stage.opens,
        closes=stage.closes,
        is_open=track.taken_here and stage.is_open(now),
        accepts=list(stage.accepts),
        list_kind=stage.list if track.taken_here else None,
        commitment=sealed.commitment if sealed else None,
        secret=sealed.secret if sealed and sealed.revealed_at else None,
        scored_runs=stage.quotas.scored_runs,
        attempts=stage.quotas.attempts,
        qualified=stage.qualified.sentence if stage.qualified else None,
    )
