"""The best entry of each team on a board, found and ranked by the database; called by the boards and for places.

The order is that of `vitac.evaluator.scoring.ranking.rank`, which a test compares on random standings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from uuid import UUID

from sqlalchemy import ColumnElement, Select, lateral, select, true
from sqlalchemy.orm import Session, aliased
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track
from vitac.evaluator.version import evaluator_version

from ..db.models import ALL_TASKS, BoardResult, Team
from ..views.submissions import RankView

PlacesOfBoards = Mapping[str | None, Mapping[UUID, RankView]]
"""Places by submission on each board of a track: that of a task, or under None that of all tasks together."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """What is ranked together: results of one kind in one task of a track, or with `task` None in all of them."""

    track: str
    kind: SubmissionKind = SubmissionKind.MODEL
    task: str | None = None


@dataclass(frozen=True, kw_only=True)
class BestEntry:
    """The best entry of a team on a board. `rank` is None where another evaluator version made it."""

    rank: int | None
    evaluation_id: UUID
    submission_id: UUID


def best_entries(session: Session, board: Board) -> list[BestEntry]:
    """Return the best entry of each team, ranked; then those of teams that only have results of other versions."""
    return _ranked(session, board) + [
        BestEntry(rank=None, evaluation_id=evaluation_id, submission_id=submission_id)
        for evaluation_id, submission_id in session.execute(best_of_teams(board).where(_without_ranked(board)))
    ]


def places(session: Session, track: str) -> PlacesOfBoards:
    """Return the places of the submissions that are their team's best entry on a board of the track."""
    boards = [Board(track=track, task=task) for task in (None, *load_track(track).tasks)]
    return {board.task: _places(_ranked(session, board)) for board in boards}


def best_of_teams(board: Board, *conditions: ColumnElement[bool]) -> Select[UUID, UUID]:
    """Ids of evaluation and submission of each team's best entry, best first: one look into an index for each team.

    Args:
        board: whose results.
        conditions: by which of its results count; none: all.
    """
    best = aliased(
        BoardResult,
        lateral(
            select(BoardResult)
            .where(*_of(board), BoardResult.team_id == Team.id, *conditions)
            .order_by(*ranking_order(BoardResult))
            .limit(1)
        ),
    )
    return (
        select(best.evaluation_id, best.submission_id)
        .select_from(Team)
        .join(best, true())
        .order_by(*ranking_order(best))
    )


def ranking_order(result: type[BoardResult]) -> tuple[ColumnElement[Any], ...]:
    """High success rate first, then few mean env steps, none of them last, then the earlier one, then the id."""
    return (result.success_rate.desc(), result.mean_steps.asc(), result.submitted_at.asc(), result.evaluation_id.asc())


def _ranked(session: Session, board: Board) -> list[BestEntry]:
    ids = session.execute(best_of_teams(board, _of_this_version())).all()
    return [
        BestEntry(rank=rank, evaluation_id=evaluation_id, submission_id=submission_id)
        for rank, (evaluation_id, submission_id) in enumerate(ids, start=1)
    ]


def _of(board: Board) -> tuple[ColumnElement[bool], ...]:
    return (
        BoardResult.track == board.track,
        BoardResult.kind == board.kind,
        BoardResult.board == (board.task or ALL_TASKS),
    )


def _of_this_version() -> ColumnElement[bool]:
    return BoardResult.evaluator_version == evaluator_version()


def _without_ranked(board: Board) -> ColumnElement[bool]:
    """Return whether the team has no result of this version on the board."""
    ranked = aliased(BoardResult)
    return ~(
        select(ranked.evaluation_id)
        .where(
            ranked.track == board.track,
            ranked.kind == board.kind,
            ranked.board == (board.task or ALL_TASKS),
            ranked.evaluator_version == evaluator_version(),
            ranked.team_id == Team.id,
        )
        .exists()
    )


def _places(entries: Sequence[BestEntry]) -> dict[UUID, RankView]:
    return {entry.submission_id: RankView(rank=rank, of=len(entries)) for rank, entry in enumerate(entries, start=1)}
