"""Makes the view of the competition; called by API and pages."""

from collections.abc import Mapping, Sequence
from datetime import datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import ListKind

from ..database.clock import read_clock
from ..database.models import SealedList, Submission, Team
from ..errors import ProblemCode, ServiceError
from ..views.by_hand import EnteredTaskView
from ..views.competition import (
    CompetitionListView,
    CompetitionState,
    CompetitionSummaryView,
    CompetitionTrackView,
    CompetitionView,
    DisqualifiedTeamView,
    PrizeView,
    ReopeningView,
    StageView,
    WinnerView,
    WithdrawnListView,
)
from .competition import Competition, list_competition_choices
from .sealing import sealed_lists
from .stages import Stage

Lists = Mapping[tuple[str, str], SealedList]


def competition_list_view(session: Session) -> CompetitionListView:
    """Return all competitions, the one that opened last first."""
    now = read_clock(session)
    return CompetitionListView(
        items=[
            CompetitionSummaryView.from_row(
                competition,
                title=competition.definition.title,
                summary=competition.definition.summary,
                state=_state(competition, now),
                tracks=list(dict.fromkeys(stage.track for stage in competition.stages_held_here)),
                public_rankings=list(competition.definition.public_rankings.values()),
            )
            for competition in Competition.read_all(session)
            if competition.is_held
        ]
    )


def list_choices(session: Session) -> Sequence[CompetitionSummaryView]:
    """Return the competitions between which an upload has to choose; empty where no track has several now."""
    names = {competition.name for competition in list_competition_choices(session, read_clock(session))}
    return [view for view in competition_list_view(session).items if view.name in names]


def competition_view(session: Session, name: str | None = None, *, at: datetime | None = None) -> CompetitionView:
    """Return a competition; `name` None: the one that opened last, `at` None: now.

    Raises:
        ServiceError: this service runs none.
    """
    competition, now = Competition.find(session, name) if name else Competition.read(session), at or read_clock(session)
    if not competition.is_held:
        raise ServiceError(ProblemCode.NOT_FOUND, "This service runs no competition; all its tracks are for practice.")
    definition, row, lists = competition.definition, competition.row, _lists(competition)
    return CompetitionView.from_row(
        definition,
        rules=list(definition.rules),
        tracks=[_track(name, competition, lists, now) for name in definition.tracks],
        public_rankings=list(definition.public_rankings.values()),
        frozen_at=competition.frozen_at,
        finalized_at=row.finalized_at,
        reopened=[ReopeningView.model_validate(each) for each in row.reopened],
        winners=[WinnerView.model_validate(winner, extra="ignore") for winner in row.winners or []],
        disqualified=disqualified_since_the_end(competition),
        withdrawn_lists=[
            WithdrawnListView.model_validate(each, from_attributes=True)
            for each in sealed_lists(competition.session, competition)
            if each.withdrawn_at is not None
        ],
    )


def disqualified_since_the_end(competition: Competition) -> list[DisqualifiedTeamView]:
    """Return the teams among the stored winners and boards that were disqualified later, or whose entry was.

    There are none before the end.
    """
    row = competition.row
    if row.finalized_at is None:
        return []
    kept = {winner["submission"] or winner["team_id"]: winner["team"] for winner in row.winners or ()}
    kept |= {entry["submission_id"]: entry["team"] for board in row.boards or () for entry in board["entries"]}
    since_when = func.coalesce(Team.disqualified_at, Submission.disqualified_at)
    of_submissions = select(Submission.id, since_when).join(Submission.team).where(since_when.is_not(None))
    of_teams = select(Team.id, Team.disqualified_at).where(Team.disqualified_at.is_not(None))
    rows = [*competition.session.execute(of_submissions), *competition.session.execute(of_teams)]
    since = {kept[str(identity)]: at for identity, at in rows if at and str(identity) in kept}
    return [DisqualifiedTeamView(team=team, disqualified_at=at) for team, at in sorted(since.items())]


def track_stages(
    session: Session, track: str, name: str | None = None, *, at: datetime | None = None
) -> Sequence[StageView]:
    """Return the stages of a track that is held here; empty outside of a competition.

    Args:
        session: of the transaction.
        track: which one.
        name: of the competition; None: the one whose boards the track shows.
        at: the moment; None: now.

    Raises:
        ServiceError: there is no such competition, or it does not hold the track.
    """
    competition = Competition.find_by_track(session, track, name)
    stages = [stage for stage in competition.list_stages(track) if not stage.is_practice]
    lists, now = _lists(competition) if stages else {}, at or read_clock(session)
    return [_stage(stage, lists, now) for stage in stages]


def _state(competition: Competition, now: datetime) -> CompetitionState:
    if competition.row.finalized_at is not None:
        return CompetitionState.FINAL
    if now < competition.opens:
        return CompetitionState.PLANNED
    return CompetitionState.OPEN if now < competition.closes else CompetitionState.CLOSED


def _lists(competition: Competition) -> Lists:
    return {
        (each.track, each.stage): each
        for each in sealed_lists(competition.session, competition)
        if each.withdrawn_at is None
    }


def _track(name: str, competition: Competition, lists: Lists, now: datetime) -> CompetitionTrackView:
    track = competition.definition.tracks[name]
    return CompetitionTrackView.from_row(
        track,
        name=name,
        ranking=[key.name for key in competition.list_stages(name)[0].find_ranking().keys],
        stages=[_stage(stage, lists, now) for stage in competition.stages if stage.track == name],
        prizes=[PrizeView(**prize.model_dump()) for prize in track.prizes],
        judging=track.judging.sentence if track.judging else None,
    )


def _stage(stage: Stage, lists: Lists, now: datetime) -> StageView:
    rules, sealed = stage.rules, lists.get((stage.track, stage.name))
    return StageView.from_row(
        rules,
        final_of=stage.live.name if stage.live else None,
        played_since=sealed.played_at if sealed else None,
        is_open=stage.is_open(now),
        accepts=list(rules.accepts),
        list_kind=rules.list if stage.track_rules.taken_here else None,
        is_practice=stage.track_rules.taken_here and rules.list is ListKind.PUBLIC and not stage.decides,
        commitment=sealed.commitment if sealed else None,
        secret=sealed.secret if sealed and sealed.revealed_at else None,
        scored_runs=stage.quotas.scored_runs,
        attempts=stage.quotas.attempts,
        qualified=rules.qualified.sentence if rules.qualified else None,
        is_planned=rules.plan is not None,
        brief=rules.brief.sentence if rules.brief else None,
        entered=[EnteredTaskView(**task.model_dump()) for task in rules.entered],
    )
