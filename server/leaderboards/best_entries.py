"""The best entry of each team on a board, found and ranked by the database; called by the boards and for places.

Each result has the key that sorts it (`vitac.evaluator.ranking`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from typing import Self
from uuid import UUID

from sqlalchemy import ColumnElement, Select, bindparam, lateral, select, true
from sqlalchemy.orm import Session, aliased
from vitac.evaluator.ranking import Ranking
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version

from ..competitions.stages import CountedResults, Stage
from ..database.models import ALL_TASKS, BoardResult, Team
from ..tracks import is_reference, known_track
from ..views.submissions import RankView
from .board_cache import kept_until_change

_EVER = datetime.max.replace(tzinfo=UTC)

PlacesOfBoards = Mapping[str | None, Mapping[UUID, RankView]]
"""Places by submission on each board of a track: that of a task, or under None that of all tasks together."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """What is ranked together: results of one kind in one task of a track, or with `task` None in all of them.

    Attributes:
        competition: name of the competition; empty for results outside of one.
        stage: of the competition; empty for results outside of one.
        ranking: what entries are compared by.
        evaluator_version: whose results are ranked.
        until: results that were complete then count.
    """

    track: str
    kind: SubmissionKind = SubmissionKind.MODEL
    task: str | None = None
    competition: str = ""
    stage: str = ""
    ranking: Ranking = field(default_factory=Ranking)
    evaluator_version: str = field(default_factory=evaluator_version)
    until: datetime = _EVER

    @classmethod
    def from_results(
        cls,
        stage: Stage,
        counted: CountedResults,
        *,
        kind: SubmissionKind = SubmissionKind.MODEL,
        task: str | None = None,
    ) -> Self:
        """Return a board of a stage that is made of some results."""
        return cls(
            track=stage.track,
            kind=kind,
            task=task,
            competition=stage.competition,
            stage=stage.name,
            ranking=stage.find_ranking(task),
            evaluator_version=counted.evaluator_version,
            until=counted.frozen_at or counted.final_since or _EVER,
        )


@dataclass(frozen=True, kw_only=True)
class BestEntry:
    """The best entry of a team on a board. `rank` is None where another version made it, and of a copied log."""

    rank: int | None
    evaluation_id: UUID
    submission_id: UUID
    ranked_by: Mapping[str, float | None]

    def __str__(self) -> str:
        """Return a short text that no other entry has: revisions of boards are made of hundreds of them."""
        return f"{self.rank} {self.evaluation_id.int:x}"


def best_entries(session: Session, board: Board) -> list[BestEntry]:
    """Return the best entry of each team, ranked; then those of teams that only have results of other versions."""
    unranked = session.execute(_best_of_other_versions(), _parameters(board))
    return ranked_entries(session, board) + [BestEntry(rank=None, **row) for row in unranked.mappings()]


def ranked_entries(session: Session, board: Board) -> list[BestEntry]:
    """Return the best entry of each team that the board's evaluator version has made, ranked."""
    ranked = session.execute(_best_of_teams(), _parameters(board))
    return [BestEntry(rank=rank, **row) for rank, row in enumerate(ranked.mappings(), start=1)]


def places(session: Session, combined: Board) -> PlacesOfBoards:
    """Return the places of all ranked submissions on a track's board of all tasks together, and on that of each.

    Args:
        session: of the transaction.
        combined: the board of all tasks together.
    """
    track = known_track(combined.track)
    tasks = (None, *(name for name, task in track.tasks.items() if not is_reference(task))) if track else ()
    boards = [replace(combined, task=task) for task in tasks]

    def read() -> PlacesOfBoards:
        return {board.task: _places(ranked_entries(session, board)) for board in boards}

    return kept_until_change(session, tuple(boards), read)


def _places(ranked: Sequence[BestEntry]) -> dict[UUID, RankView]:
    return {entry.submission_id: RankView(rank=rank, of=len(ranked)) for rank, entry in enumerate(ranked, start=1)}


def _parameters(board: Board) -> dict[str, object]:
    return {
        "track": board.track,
        "competition": board.competition,
        "stage": board.stage,
        "kind": board.kind,
        "board": board.task or ALL_TASKS,
        "version": board.evaluator_version,
        "until": board.until,
    }


def _order(result: type[BoardResult]) -> tuple[ColumnElement[object], ...]:
    """Return the order of the boards: by the keys of the ranking, then by id."""
    return result.sort_key, result.evaluation_id  # type: ignore[return-value]


# Building a statement takes longer than running it, so each is built once and filled by its parameters.


@cache
def _best_of_teams() -> Select[UUID, UUID, dict[str, float | None]]:
    """Return each team's best entry of a version, best first."""
    best = _best_result(_has_version(BoardResult), ~BoardResult.is_copy)
    return _select(best).select_from(Team).join(best, true()).where(takes_part()).order_by(*_order(best))


@cache
def _best_of_other_versions() -> Select[UUID, UUID, dict[str, float | None]]:
    """Return the same of teams without a ranked entry of the version: made by another one, or copies."""
    best, ranked = _best_result(), aliased(BoardResult)
    has_ranked = (
        select(ranked.evaluation_id)
        .where(*_board_conditions(ranked), _has_version(ranked), ~ranked.is_copy, ranked.team_id == Team.id)
        .exists()
    )
    others = _select(best).select_from(Team).join(best, true()).where(~has_ranked, takes_part())
    return others.order_by(*_order(best))


def _best_result(*conditions: ColumnElement[bool]) -> type[BoardResult]:
    """Return the best result of the team at hand on a board, for a join: one look into an index for each team."""
    return aliased(
        BoardResult,
        lateral(
            select(BoardResult)
            .where(*_board_conditions(BoardResult), BoardResult.team_id == Team.id, *conditions)
            .order_by(*_order(BoardResult))
            .limit(1)
        ),
    )


def _board_conditions(result: type[BoardResult]) -> tuple[ColumnElement[bool], ...]:
    return (
        result.competition == bindparam("competition"),
        result.track == bindparam("track"),
        result.stage == bindparam("stage"),
        result.kind == bindparam("kind"),
        result.board == bindparam("board"),
        result.finished_at <= bindparam("until"),
        ~result.is_off_boards,
    )


def takes_part() -> ColumnElement[bool]:
    """Return whether a row of `teams` is on boards."""
    return Team.disqualified_at.is_(None)


def _has_version(result: type[BoardResult]) -> ColumnElement[bool]:
    return result.evaluator_version == bindparam("version")


def _select(best: type[BoardResult]) -> Select[UUID, UUID, dict[str, float | None]]:
    return select(best.evaluation_id, best.submission_id, best.ranked_by)
