"""Who advances to a stage: proposed by the stage's rule, decided by the organizers, recorded."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from math import ceil
from uuid import UUID

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from ..accounts import teams
from ..accounts.outbox import announce, stage_facts
from ..audit import record
from ..competitions.competition import Competition
from ..competitions.definition import Advancement
from ..competitions.stages import Stage
from ..confirmations import compute_revision, require_base
from ..database.clock import read_clock
from ..database.models import Qualification, Submission, Team
from ..database.states import NoticeKind
from ..errors import ProblemCode, ServiceError
from ..evaluations.history import count_running, require_current, require_scored
from ..leaderboards.standings import leaderboard
from ..principals import Principal
from ..transparency.entries import TeamsAdvanced
from ..transparency.log import append
from ..views.competition import AdvancementView, ProposedTeamView
from ..views.leaderboards import LeaderboardEntryView


def propose(session: Session, by: Principal, stage: Stage) -> AdvancementView:
    """Return who advances to a stage by its rule, as the boards are now, and who was confirmed.

    Raises:
        ServiceError: not an organizer, or the stage is for all teams.
    """
    by.require_organizer(stage.competition)
    before, rule = _rule(stage)
    entries = leaderboard(session, before, live=True).view.entries
    ranked = [entry for entry in entries if entry.rank is not None]
    taking_part = (Team.disqualified_at.is_(None), Team.approved_at.is_not(None), Team.created_at < before.rules.closes)
    registered = session.scalars(select(func.count()).select_from(Team).where(*taking_part)).one()
    n_advancing = _count_advancing(rule, ranked, registered)
    qualified = _qualified(session, stage)
    return AdvancementView(
        track=stage.track,
        stage=stage.name,
        before=before.name,
        rule=rule.sentence,
        registered=registered,
        teams=[_proposed(entry, rule, ranked, n_advancing) for entry in ranked],
        unranked=[entry.team for entry in entries if entry.rank is None],
        running=count_running(session, before),
        confirmed=sorted(qualified.values()),
        revision=_compute_revision(qualified),
    )


def confirm(
    session: Session,
    by: Principal,
    stage: Stage,
    *,
    add: Collection[str] = (),
    without: Collection[str] = (),
    base: str | None = None,
) -> list[str]:
    """Let the proposed teams take part in a stage, and return which; the organizers' own decisions are added.

    Confirming again replaces the confirmed teams, but for those that have submitted to the stage already.

    Args:
        session: of the transaction.
        by: an organizer.
        stage: which one.
        add: names of further teams.
        without: names of proposed teams that do not take part.
        base: revision of the confirmed teams that the decision was made against; None: the caller compares itself.

    Raises:
        ServiceError: not an organizer, others were confirmed since, the stage before is not over, scored and of
            today's evaluator, a team is unknown or not proposed, or one that would lose its place has submitted
            already.
    """
    by.require_organizer(stage.competition)
    Competition.lock(session, stage.competition)  # of two at once the second sees whom the first has confirmed
    proposal, (before, _) = propose(session, by, stage), _rule(stage)
    before.require_over()
    require_scored(session, before)
    require_current(session, before)
    chosen = _chosen(session, proposal, add, without)
    previous = _qualified(session, stage)
    if chosen.keys() != previous.keys():
        new, leaving = chosen.items() - previous.items(), previous.items() - chosen.items()
        require_base(
            f"the list of teams confirmed for {stage}",
            base=base,
            revision=_compute_revision(previous),
            difference=lambda: f"Yours would add {_names(new)} and remove {_names(leaving)}.",
        )
    _refuse_loss(session, stage, previous.keys() - chosen.keys())
    session.execute(delete(Qualification).where(stage.qualifications))
    now = read_clock(session)
    for team_id in chosen.keys() - previous.keys():
        facts = stage_facts(stage) | {"team": chosen[team_id]}
        announce(session, NoticeKind.PROMOTED, team_id, f"{stage.subject}/{team_id}/{now.isoformat()}", facts)
    session.add_all(Qualification(**stage.place, team_id=team_id) for team_id in chosen)
    session.flush()
    after = {
        "teams": sorted(chosen.values()),
        "rule": proposal.rule,
        "proposed": [team.team for team in proposal.teams if team.advances],
        "at_border": [team.team for team in proposal.teams if team.at_border],
    }
    record(session, by, "stage.qualify", stage.subject, after, before={"teams": sorted(previous.values())})
    if chosen.keys() != previous.keys():
        _log(session, stage, before, chosen.values())
    return sorted(chosen.values())


def _log(session: Session, stage: Stage, before: Stage, chosen: Collection[str]) -> None:
    """Add to the log who takes part, by what the board before shows of them: names of teams may be hidden."""
    entries = leaderboard(session, before, live=True).view.entries
    submissions = tuple(entry.submission_id for entry in entries if entry.team in chosen)
    append(
        session,
        lambda at: TeamsAdvanced(
            **stage.place,
            issued_at=at,
            teams=len(chosen),
            submissions=submissions,
        ),
    )


def _rule(stage: Stage) -> tuple[Stage, Advancement]:
    """Return the stage whose board decides, and by which rule."""
    if stage.before is None or stage.rules.qualified is None:
        raise ServiceError(
            ProblemCode.UNKNOWN_STAGE, f"Stage {stage.name} of {stage.track} is for all teams; nobody advances."
        )
    if stage.rules.qualified.committee:
        raise ServiceError(
            ProblemCode.UNKNOWN_STAGE,
            f"A committee decides who enters stage {stage.name} of {stage.track}, by the briefs of "
            f"{stage.before.name}: `vitac admin brief decide`.",
        )
    return stage.before, stage.rules.qualified


def _count_advancing(rule: Advancement, ranked: Sequence[LeaderboardEntryView], registered: int) -> int:
    if rule.score_at_least is not None:
        return sum(entry.success_rate >= rule.score_at_least for entry in ranked)
    if rule.top is not None:
        return min(rule.top, len(ranked))
    # The share as it is written: 0.07 of 100 teams are 7, whatever the nearest binary fraction is.
    return min(ceil(Fraction(str(rule.top_share)) * registered), len(ranked))


def _proposed(
    entry: LeaderboardEntryView, rule: Advancement, ranked: Sequence[LeaderboardEntryView], n_advancing: int
) -> ProposedTeamView:
    rank = entry.rank or 0
    advances = entry.success_rate >= rule.score_at_least if rule.score_at_least is not None else rank <= n_advancing
    return ProposedTeamView.from_row(
        entry,
        rank=rank,
        interval=entry.success_rate_interval,
        advances=advances,
        at_border=_is_at_border(entry, rule, ranked, n_advancing, advances=advances),
    )


def _is_at_border(
    entry: LeaderboardEntryView,
    rule: Advancement,
    ranked: Sequence[LeaderboardEntryView],
    n_advancing: int,
    *,
    advances: bool,
) -> bool:
    """Return whether the interval holds the score that is needed, or meets that of the nearest on the other side."""
    low, high = entry.success_rate_interval
    if rule.score_at_least is not None:
        return low <= rule.score_at_least <= high
    other_side = ranked[n_advancing:] if advances else ranked[:n_advancing]
    if not other_side:
        return False
    nearest = other_side[0] if advances else other_side[-1]
    return low <= nearest.success_rate_interval[1] and nearest.success_rate_interval[0] <= high


def _chosen(
    session: Session, proposal: AdvancementView, add: Collection[str], without: Collection[str]
) -> dict[UUID, str]:
    advancing = [teams.find(session, team.team) for team in proposal.teams if team.advances]
    chosen = {team.id: team.name for team in advancing}
    for team in (teams.find(session, name) for name in without):
        if team.id not in chosen:
            raise ServiceError(ProblemCode.INVALID_REQUEST, f"{team.name} is not proposed, so it cannot be left out.")
        del chosen[team.id]
    for team in (teams.find(session, name) for name in add):
        if team.disqualified_at is not None:
            raise ServiceError(ProblemCode.TEAM_DISQUALIFIED, f"{team.name} is disqualified.")
        chosen[team.id] = team.name
    return chosen


def _qualified(session: Session, stage: Stage) -> dict[UUID, str]:
    rows = session.execute(
        select(Team.id, Team.name).join(Qualification, Qualification.team_id == Team.id).where(stage.qualifications)
    )
    return {row.id: row.name for row in rows}


def _compute_revision(qualified: Mapping[UUID, str]) -> str:
    return compute_revision(sorted(map(str, qualified)))


def _names(teams: Iterable[tuple[UUID, str]]) -> str:
    return ", ".join(sorted(name for _, name in teams)) or "nobody"


def _refuse_loss(session: Session, stage: Stage, leaving: Collection[UUID]) -> None:
    submitted = select(Team.name).join(Submission).where(stage.submissions, Team.id.in_(leaving))
    name = session.scalar(submitted.limit(1))
    if name is not None:
        raise ServiceError(ProblemCode.STAGE_IN_USE, f"{name} has submitted to {stage}; disqualify it instead.")
