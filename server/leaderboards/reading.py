"""Boards as their readers see them, found by track, stage and competition; called by API and pages."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, date
from enum import StrEnum
from typing import Self, TypeVar

from sqlalchemy.orm import Session

from .. import names
from ..competitions.competition import Competition
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..views.leaderboards import BaselineView, BoardEntryView, LeaderboardView, LogBoardsView, TeamRanksView
from .best_entries import Board
from .board_cache import MadeBoard
from .history import rank_history
from .log_boards import log_boards
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


MAX_TEXT = 64
LONGEST_KEY = 1024
"""Of a team's name in lower case, which may be longer than the name."""


class ShownRows(StrEnum):
    """Which rows of a board are shown."""

    ALL = "all"
    ENTRIES = "entries"
    BASELINES = "baselines"


EntryT = TypeVar("EntryT", bound=BoardEntryView)


@dataclass(frozen=True, kw_only=True)
class BoardSearch:
    """What entries must have to be shown.

    Attributes:
        team: part of the team's name, in any case and with any spaces; empty: all teams.
        since: first day of submission (UTC); None: any.
        until: last day of submission (UTC); None: any.
        rows: entries, baselines, or both.
    """

    team: str = ""
    since: date | None = None
    until: date | None = None
    rows: ShownRows = ShownRows.ALL

    @classmethod
    def read(cls, query: Mapping[str, str]) -> Self:
        """Return the search that the query of an address names by `q`, `since`, `until` and `rows`.

        Raises:
            ServiceError: a day or the kind of rows cannot be read.
        """
        rows = query.get("rows") or ShownRows.ALL
        if rows not in set(ShownRows):
            raise _invalid("rows", "all, entries or baselines", rows)
        team = query.get("q", "").strip()[:MAX_TEXT]
        return cls(team=team, since=_read_day(query, "since"), until=_read_day(query, "until"), rows=ShownRows(rows))

    def query(self) -> list[tuple[str, str]]:
        """Return names and values in the query of an address."""
        asked = (("q", self.team), ("since", self.since), ("until", self.until))
        rows = [] if self.rows is ShownRows.ALL else [("rows", self.rows.value)]
        return [(name, str(value)) for name, value in asked if value] + rows

    @property
    def is_empty(self) -> bool:
        """Whether everything is shown."""
        return not self.query()

    def find(self, entries: Iterable[EntryT]) -> list[EntryT]:
        """Return the entries that are shown."""
        wanted = names.key(self.team, max_length=MAX_TEXT)
        return (
            [entry for entry in entries if self._shows(entry, wanted)] if self.rows is not ShownRows.BASELINES else []
        )

    def find_baselines(self, baselines: Iterable[BaselineView]) -> list[BaselineView]:
        """Return the baselines that are shown: all, unless entries alone, a team or dates are looked for."""
        is_shown = self.rows is ShownRows.BASELINES or self.is_empty
        return list(baselines) if is_shown else []

    def apply(self, board: LeaderboardView) -> LeaderboardView:
        """Return a leaderboard with the rows that are shown."""
        parts = {"entries": self.find(board.entries), "baselines": self.find_baselines(board.baselines)}
        return board if self.is_empty else board.model_copy(update=parts)

    def apply_to_logs(self, logs: LogBoardsView) -> LogBoardsView:
        """Return boards of logs with the entries that are shown."""
        boards = [board.model_copy(update={"entries": self.find(board.entries)}) for board in logs.boards]
        changes = {"boards": boards, "text_logs": self.find(logs.text_logs)}
        return logs if self.is_empty else logs.model_copy(update=changes)

    def _shows(self, entry: BoardEntryView, wanted: str) -> bool:
        day = entry.submitted_at.astimezone(UTC).date()
        if (self.since and day < self.since) or (self.until and day > self.until):
            return False
        return wanted in names.key(entry.team, max_length=LONGEST_KEY)


def _read_day(query: Mapping[str, str], name: str) -> date | None:
    text = query.get(name, "")
    try:
        return date.fromisoformat(text) if text else None
    except ValueError as error:
        raise _invalid(name, "a day as 2026-03-31", text) from error


def _invalid(name: str, expected: str, got: str) -> ServiceError:
    return ServiceError(ProblemCode.INVALID_REQUEST, f"Expected {expected} as {name}, got {got[:40]!r}; change it.")
