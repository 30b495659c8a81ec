"""What is not settled when a competition ends; whoever ends it confirms each by its name."""

from collections.abc import Iterator
from datetime import datetime, timedelta

from sqlalchemy import func, select

from ..competitions.competition import Competition
from ..confirmations import Concern
from ..database.models import Evaluation, Rejudgement
from ..leaderboards.standings import leaderboard
from ..submissions.appeals import open_in_competition


def unsettled(competition: Competition, now: datetime) -> list[Concern]:
    """Return what would be settled by the end alone: appeals, their time, rejudgements, boards without a rank."""
    return [*_appeals(competition), *_appeal_time(competition, now), *_rejudgements(competition), *_boards(competition)]


def _appeals(competition: Competition) -> Iterator[Concern]:
    if waiting := open_in_competition(competition.session, competition):
        listed = ", ".join(f"{one.id} of {one.team.name}" for one in waiting)
        yield Concern(
            name="open_appeals", sentence=f"No ruling was made on appeals {listed}; they are rejected with the end."
        )


def _appeal_time(competition: Competition, now: datetime) -> Iterator[Concern]:
    days = competition.definition.appeal_days
    in_competition = competition.submissions, Evaluation.is_proposed.is_(False)
    query = select(func.max(Evaluation.finished_at)).join(Evaluation.submission).where(*in_competition)
    last = competition.session.scalar(query)
    if days is not None and last is not None and (until := last + timedelta(days=days)) > now:
        yield Concern(
            name="appeal_time", sentence=f"Teams may appeal until {until:%F %T} UTC; with the end they no longer can."
        )


def _rejudgements(competition: Competition) -> Iterator[Concern]:
    waiting = Rejudgement.applied_at.is_(None), Rejudgement.discarded_at.is_(None)
    in_competition = Rejudgement.competition == competition.name, Rejudgement.stage != ""
    rejudgements = competition.session.scalars(
        select(Rejudgement).where(*in_competition, *waiting).order_by(Rejudgement.started_at)
    ).all()
    if rejudgements:
        listed = ", ".join(f"{one.id} of stage {one.stage} of {one.track}" for one in rejudgements)
        yield Concern(name="rejudgements", sentence=f"Rejudgements {listed} are neither applied nor discarded.")


def _boards(competition: Competition) -> Iterator[Concern]:
    boards = [leaderboard(competition.session, stage, live=True).view for stage in competition.stages_held_here]
    unranked = [board for board in boards if board.entries and all(entry.rank is None for entry in board.entries)]
    if unranked:
        listed = ", ".join(f"stage {board.stage} of {board.track}" for board in unranked)
        yield Concern(
            name="boards_without_ranks",
            sentence=f"No entry on the board of {listed} has a rank: another evaluator version made them; rejudge.",
        )
