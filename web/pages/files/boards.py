"""Boards as CSV. As JSON they are what the API answers, which needs no token for them."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.leaderboards.reading import shown_leaderboard, shown_log_boards
from vitac.server.views.board_table import BOARD_COLUMNS, board_table, ranked_cells
from vitac.server.views.leaderboards import LogBoardsView

from ...site import get_principal, get_site, get_viewer
from ..addresses import AskedBoard
from .formats import csv_file

LOG_COLUMNS = ("kind", "task", *BOARD_COLUMNS, "verification", "copy_of_team", "copied_episodes")
TEXT_LOG_COLUMNS = (
    "team", "submission", "task", "claimed_success_rate", "success_rate", "claimed_mean_env_steps", "mean_env_steps",
    "problems", "submitted_at", "evaluator_version",
)  # fmt: skip


async def leaderboard(request: Request) -> Response:
    """Return a board with a row for each entry."""
    asked, by = AskedBoard.read(request), get_principal(await get_viewer(request))
    board = await get_site(request).read(
        lambda session: (
            shown_leaderboard(
                session, by, asked.track, task=asked.task, stage=asked.stage, competition=asked.competition
            ).view
        )
    )
    columns, rows = board_table(board.model_dump(mode="json"))
    return csv_file(_name(asked, asked.task or "all"), columns, rows)


async def logs(request: Request) -> Response:
    """Return the verified logs of a track, a row for each, by task and rank."""
    asked = AskedBoard.read(request, logs=True)
    boards = await _log_boards(request, asked)
    rows = (
        (
            board.kind,
            board.task,
            *ranked_cells(entry.model_dump(mode="json")),
            entry.verdict,
            entry.copy_of.team if entry.copy_of else None,
            entry.copy_of.episodes if entry.copy_of else None,
        )
        for board in boards.boards
        for entry in board.entries
    )
    return csv_file(_name(asked, "logs"), LOG_COLUMNS, rows)


async def text_logs(request: Request) -> Response:
    """Return the 2025 text logs of a track beside their claims, newest first."""
    asked = AskedBoard.read(request, logs=True)
    boards = await _log_boards(request, asked)
    rows = (
        (
            log.team,
            log.submission_name,
            log.task,
            log.claimed_success_rate,
            log.success_rate,
            log.claimed_mean_steps,
            log.mean_steps,
            log.problems,
            log.submitted_at.isoformat(),
            log.evaluator_version,
        )
        for log in boards.text_logs
    )
    return csv_file(_name(asked, "text-logs"), TEXT_LOG_COLUMNS, rows)


async def _log_boards(request: Request, asked: AskedBoard) -> LogBoardsView:
    by = get_principal(await get_viewer(request))
    return await get_site(request).read(
        lambda session: (
            shown_log_boards(session, by, asked.track, stage=asked.stage, competition=asked.competition).view
        )
    )


def _name(asked: AskedBoard, what: str) -> str:
    return "-".join(filter(None, (asked.competition, asked.track, asked.stage, what)))
