"""The ranks of a board's first teams over time; called by the boards as they are shown."""

from bisect import bisect_left, insort
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from functools import cache
from typing import Any
from uuid import UUID

from sqlalchemy import RowMapping, Select, Text, bindparam, func, select, tuple_
from sqlalchemy.dialects.postgresql import ARRAY
from sqlalchemy.orm import Session
from vitac.evaluator.ranking import SUCCESS_RATE, RankingKey

from ..competitions.competition import find_stage
from ..database.models import ALL_TASKS, BoardResult, Evaluation, Submission, Team
from ..principals import Principal
from ..views.leaderboards import DatedRankView, LeaderboardEntryView, PastResultView, TeamRanksView
from ..visibility import visible
from .best_entries import Board, takes_part
from .board_cache import kept_until_change

TEAMS = 8
"""Number of teams whose ranks are followed."""

Ranks = Mapping[UUID, Sequence[DatedRankView]]
"""By the evaluation of the team's present entry, each change of its rank."""


def rank_history(session: Session, board: Board, entries: Collection[LeaderboardEntryView]) -> list[TeamRanksView]:
    """Return each change of the ranks of a board's first teams.

    Args:
        session: of the transaction.
        board: which one.
        entries: as it shows them, with the names of their teams.
    """
    ranks = kept_until_change(session, ("rank history", board), lambda: _follow(_read(session, board)))
    return [
        TeamRanksView(team=entry.team, submission_id=entry.submission_id, ranks=list(ranks[entry.evaluation_id]))
        for entry in entries
        if entry.evaluation_id in ranks
    ]


def _read(session: Session, board: Board) -> Sequence[BoardResult]:
    """Return all results that the board ranked at some time, in the order in which they were complete."""
    query = (
        select(BoardResult)
        .join(Team, Team.id == BoardResult.team_id)
        .where(
            BoardResult.competition == board.competition,
            BoardResult.track == board.track,
            BoardResult.stage == board.stage,
            BoardResult.kind == board.kind,
            BoardResult.board == (board.task or ALL_TASKS),
            BoardResult.evaluator_version == board.evaluator_version,
            BoardResult.finished_at <= board.until,
            ~BoardResult.is_off_boards,
            ~BoardResult.is_copy,
            takes_part(),
        )
        .order_by(BoardResult.finished_at, BoardResult.evaluation_id)
    )
    return session.scalars(query).all()


def _follow(results: Sequence[BoardResult]) -> Ranks:
    """Return the changes of ranks of the teams that are first at the end."""
    final: dict[UUID, tuple[Any, ...]] = {}
    for result in results:
        key = _key(result)
        final[result.team_id] = min(key, final.get(result.team_id, key))
    first = sorted(final, key=final.__getitem__)[:TEAMS]
    changes: dict[UUID, list[DatedRankView]] = {team: [] for team in first}
    best: dict[UUID, tuple[Any, ...]] = {}
    order: list[tuple[Any, ...]] = []
    for result in results:
        key, before = _key(result), best.get(result.team_id)
        if before is not None and before <= key:
            continue
        if before is not None:
            order.pop(bisect_left(order, before))
        insort(order, key)
        best[result.team_id] = key
        _note(changes, best, order, result.finished_at)
    return {final[team][-1]: changes[team] for team in first}


def _note(
    changes: Mapping[UUID, list[DatedRankView]],
    best: Mapping[UUID, tuple[Any, ...]],
    order: Sequence[tuple[Any, ...]],
    at: datetime,
) -> None:
    for team, noted in changes.items():
        rank = bisect_left(order, best[team]) + 1 if team in best else None
        if rank is not None and (not noted or noted[-1].rank != rank):
            noted.append(DatedRankView(at=at, rank=rank))


def _key(result: BoardResult) -> tuple[Any, ...]:
    """Return what a result is ordered by, low first, the id last, as the boards have it."""
    return (*result.sort_key, result.evaluation_id)


MAX_RESULTS = 500


def past_results(session: Session, by: Principal, shown: Evaluation) -> list[PastResultView]:
    """Return what the team of an evaluation has reached in its tasks, with submissions of its kind, newest first.

    Results of other evaluator versions and stages are left out: they are not comparable. Nothing before its own result.

    Raises:
        ServiceError: there is no such submission for them.
    """
    submission = visible(session, by, shown.submission_id)
    asked = {
        "evaluation": shown.id,
        "team": submission.team_id,
        "track": submission.track,
        "kind": submission.kind,
        "tasks": submission.tasks,
        "evaluator_version": shown.evaluator_version,
        "at_most": MAX_RESULTS,
    }
    stage = find_stage(session, submission)
    compared = {task: stage.find_ranking(task).compared_first for task in submission.tasks}
    rows = session.execute(_results(), asked).mappings()
    return [_past_result(row, compared[row["task"]]) for row in rows]


def _past_result(row: RowMapping, ranked_by: RankingKey) -> PastResultView:
    values = row["ranked_by"]
    return PastResultView(
        task=row["task"],
        submission_id=row["submission_id"],
        submission_name=row["submission_name"],
        submitted_at=row["submitted_at"],
        success_rate=values[SUCCESS_RATE.name],
        ranked_by=ranked_by,
        value=values.get(ranked_by.name),
    )


@cache
def _results() -> Select[*tuple[Any, ...]]:
    """Return the query of past results, put together once: each page of a submission asks it of its team."""
    own = BoardResult.evaluation_id == bindparam("evaluation")
    stage = select(BoardResult.competition, BoardResult.stage).where(own).limit(1)
    return (
        select(
            BoardResult.board.label("task"),
            BoardResult.submission_id,
            Submission.name.label("submission_name"),
            BoardResult.submitted_at,
            BoardResult.ranked_by,
        )
        .join(Submission, Submission.id == BoardResult.submission_id)
        .where(
            BoardResult.team_id == bindparam("team"),
            BoardResult.track == bindparam("track"),
            BoardResult.kind == bindparam("kind"),
            BoardResult.board == func.any(bindparam("tasks", type_=ARRAY(Text))),
            BoardResult.evaluator_version == bindparam("evaluator_version"),
            tuple_(BoardResult.competition, BoardResult.stage) == stage.scalar_subquery(),
        )
        .order_by(BoardResult.submitted_at.desc(), BoardResult.submission_id)
        .limit(bindparam("at_most"))
    )
