"""Boards as CSV. As JSON they are what the API answers, which needs no token for them."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.leaderboards.reading import shown_leaderboard, shown_log_boards
from vitac.server.views.leaderboards import LeaderboardEntryView, LogBoardsView, LogEntryView

from ...site import get_principal, get_site, get_viewer
from ..addresses import AskedBoard
from .formats import csv_file

BOARD_COLUMNS = (
    "rank", "team", "submission", "success_rate", "interval_low", "interval_high", "mean_env_steps", "successes",
    "episodes", "submitted_at", "evaluator_version", "result_hash", "peak_force_n",
)  # fmt: skip
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
    measures = [key.name for key in board.ranking.measures]
    rows = ((*_ranked(entry), *(entry.measures.get(name) for name in measures)) for entry in board.entries)
    return csv_file(_name(asked, asked.task or "all"), (*BOARD_COLUMNS, *measures), rows)


async def logs(request: Request) -> Response:
    """Return the verified logs of a track, a row for each, by task and rank."""
    asked = AskedBoard.read(request, logs=True)
    found = await _log_boards(request, asked)
    rows = (
        (
            board.kind,
            board.task,
            *_ranked(entry),
            entry.verdict,
            entry.copy_of.team if entry.copy_of else None,
            entry.copy_of.episodes if entry.copy_of else None,
        )
        for board in found.boards
        for entry in board.entries
    )
    return csv_file(_name(asked, "logs"), LOG_COLUMNS, rows)


async def text_logs(request: Request) -> Response:
    """Return the 2025 text logs of a track beside their claims, newest first."""
    asked = AskedBoard.read(request, logs=True)
    found = await _log_boards(request, asked)
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
        for log in found.text_logs
    )
    return csv_file(_name(asked, "text-logs"), TEXT_LOG_COLUMNS, rows)


async def _log_boards(request: Request, asked: AskedBoard) -> LogBoardsView:
    by = get_principal(await get_viewer(request))
    return await get_site(request).read(
        lambda session: (
            shown_log_boards(session, by, asked.track, stage=asked.stage, competition=asked.competition).view
        )
    )


def _ranked(entry: LeaderboardEntryView | LogEntryView) -> tuple[object, ...]:
    return (
        entry.rank,
        entry.team,
        entry.submission_name,
        entry.success_rate,
        *entry.success_rate_interval,
        entry.mean_steps,
        entry.successes,
        entry.episodes,
        entry.submitted_at.isoformat(),
        entry.evaluator_version,
        entry.result_hash,
        _peak_force_n(entry),
    )


def _peak_force_n(entry: LeaderboardEntryView | LogEntryView) -> float | None:
    """Return the median peak of the force on the held part; of several tasks there is none."""
    scores = entry.scores if isinstance(entry, LeaderboardEntryView) else []
    forces = scores[0].forces if len(scores) == 1 else None
    return forces.part.peak_n if forces else None


def _name(asked: AskedBoard, what: str) -> str:
    return "-".join(filter(None, (asked.competition, asked.track, asked.stage, what)))
