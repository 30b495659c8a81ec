"""Boards as CSV. As JSON they are what the API answers, which needs no token for them."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.leaderboards.shown import shown_leaderboard, shown_log_boards
from vitac.server.views.leaderboards import LeaderboardEntryView, LogBoardsView, LogEntryView

from ...site import principal_of, site_of, viewer_of
from ..addresses import read_contest_name
from .formats import csv_file

BOARD_COLUMNS = (
    "rank", "team", "submission", "success_rate", "interval_low", "interval_high", "mean_env_steps", "successes",
    "episodes", "submitted_at", "evaluator_version", "result_hash",
)  # fmt: skip
LOG_COLUMNS = ("task", *BOARD_COLUMNS, "verification", "copy_of_team", "copied_episodes")
TEXT_LOG_COLUMNS = (
    "team", "submission", "task", "claimed_success_rate", "success_rate", "claimed_mean_env_steps", "mean_env_steps",
    "problems", "submitted_at", "evaluator_version",
)  # fmt: skip


async def leaderboard(request: Request) -> Response:
    """Return a board with a row for each entry."""
    track, asked = request.path_params["track"], request.query_params
    task, stage = asked.get("task"), asked.get("stage")
    by, contest = principal_of(await viewer_of(request)), read_contest_name(request)
    board = await site_of(request).read(
        lambda session: shown_leaderboard(session, by, track, task=task, stage=stage, contest=contest).view
    )
    rows = (_ranked(entry) for entry in board.entries)
    return csv_file(_name(read_contest_name(request), track, stage, task or "all"), BOARD_COLUMNS, rows)


async def logs(request: Request) -> Response:
    """Return the verified logs of a track, a row for each, by task and rank."""
    track, stage = request.path_params["track"], request.query_params.get("stage")
    found = await _log_boards(request)
    rows = (
        (
            board.task,
            *_ranked(entry),
            entry.verdict,
            entry.copy_of.team if entry.copy_of else None,
            entry.copy_of.episodes if entry.copy_of else None,
        )
        for board in found.boards
        for entry in board.entries
    )
    return csv_file(_name(read_contest_name(request), track, stage, "logs"), LOG_COLUMNS, rows)


async def text_logs(request: Request) -> Response:
    """Return the 2025 text logs of a track beside their claims, newest first."""
    track, stage = request.path_params["track"], request.query_params.get("stage")
    found = await _log_boards(request)
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
    return csv_file(_name(read_contest_name(request), track, stage, "text-logs"), TEXT_LOG_COLUMNS, rows)


async def _log_boards(request: Request) -> LogBoardsView:
    track, stage, contest = request.path_params["track"], request.query_params.get("stage"), read_contest_name(request)
    by = principal_of(await viewer_of(request))
    return await site_of(request).read(
        lambda session: shown_log_boards(session, by, track, stage=stage, contest=contest).view
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
    )


def _name(*parts: str | None) -> str:
    return "-".join(filter(None, parts))
