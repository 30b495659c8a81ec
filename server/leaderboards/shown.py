"""Boards as their readers see them, found by track, stage and competition; called by API and pages."""

from sqlalchemy.orm import Session

from ..competition.competition import Competition
from ..principals import Principal
from ..views.leaderboards import LeaderboardView, LogBoardsView, TeamRanksView
from .best_entries import Board
from .log_boards import log_boards
from .made_boards import MadeBoard
from .rank_history import rank_history
from .standings import leaderboard


def shown_leaderboard(
    session: Session,
    by: Principal,
    track: str,
    *,
    task: str | None = None,
    stage: str | None = None,
    competition: str | None = None,
) -> MadeBoard[LeaderboardView]:
    """Return the leaderboard of a track, or of one of its tasks; organizers see all results while it is frozen.

    Args:
        session: of the transaction.
        by: who reads it.
        track: name.
        task: name; None: all tasks together.
        stage: name; None: the stage that opened last.
        competition: name of the competition; None: the one that opened last.

    Raises:
        ServiceError: one of the names is unknown.
    """
    shown = Competition.find_by_track(session, track, competition).shown_stage(track, stage)
    return leaderboard(session, shown, task=task, unfrozen=by.organizes(shown.competition))


def shown_rank_history(
    session: Session,
    by: Principal,
    track: str,
    *,
    task: str | None = None,
    stage: str | None = None,
    competition: str | None = None,
) -> list[TeamRanksView]:
    """Return the ranks of a leaderboard's first teams over time; the arguments are those of `shown_leaderboard`.

    Raises:
        ServiceError: one of the names is unknown.
    """
    shown = Competition.find_by_track(session, track, competition).shown_stage(track, stage)
    unfrozen = by.organizes(shown.competition)
    made = leaderboard(session, shown, task=task, unfrozen=unfrozen).view
    if made.is_reference:
        return []
    board = Board.from_results(shown, shown.counted_results(live=unfrozen), task=task)
    return rank_history(session, board, made.entries)


def shown_log_boards(
    session: Session, by: Principal, track: str, *, stage: str | None = None, competition: str | None = None
) -> MadeBoard[LogBoardsView]:
    """Return the logs of a track; the arguments are those of `shown_leaderboard`.

    Raises:
        ServiceError: one of the names is unknown.
    """
    shown = Competition.find_by_track(session, track, competition).shown_stage(track, stage)
    return log_boards(session, shown, unfrozen=by.organizes(shown.competition))
