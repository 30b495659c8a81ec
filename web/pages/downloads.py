"""What pages show as files: episodes and boards as CSV or JSON. A board as JSON is what the API answers."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

from starlette.responses import JSONResponse, Response
from vitac.evaluator.tracks import load_track

from ..site import open_to_all, site_of, viewer_of, visitor_of
from .addresses import as_id

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from starlette.requests import Request
    from vitac.server.views.submissions import EpisodeView

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""How a text begins that a spreadsheet would run."""
EPISODE_COLUMNS = ("task", "episode", "shape", "start", "outcome", "success", "env_steps")


def csv_file(name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Response:
    """Return a table as a file; texts that a spreadsheet would run as a formula get an apostrophe in front."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(columns)
    writer.writerows([_safe(cell) for cell in row] for row in rows)
    return _attached(Response(text.getvalue(), media_type="text/csv"), f"{name}.csv")


async def leaderboard(request: Request) -> Response:
    """Return a board with a row for each entry."""
    track, asked = request.path_params["track"], request.query_params
    task, stage = asked.get("task"), asked.get("stage")
    board = await site_of(request).data.leaderboard(track, task, stage)
    rows = (
        (
            "" if entry.rank is None else entry.rank,
            entry.team,
            entry.submission_name,
            entry.success_rate,
            *entry.success_rate_interval,
            "" if entry.mean_steps is None else entry.mean_steps,
            entry.successes,
            entry.episodes,
            entry.submitted_at.isoformat(),
            entry.evaluator_version,
            entry.result_hash,
        )
        for entry in board.entries
    )
    columns = (
        "rank", "team", "submission", "success_rate", "interval_low", "interval_high", "mean_env_steps", "successes",
        "episodes", "submitted_at", "evaluator_version", "result_hash",
    )  # fmt: skip
    return csv_file("-".join(filter(None, (track, stage, task or "all"))), columns, rows)


@open_to_all
async def episodes_csv(request: Request) -> Response:
    """Return how the episodes of a submission ended, a row for each."""
    rows = await _episodes(request)
    name = as_id(request.path_params["submission_id"])
    return csv_file(f"{name}-episodes", EPISODE_COLUMNS, ([*row.values()] for row in rows))


@open_to_all
async def episodes_json(request: Request) -> Response:
    """Return how the episodes of a submission ended, an object for each."""
    rows = await _episodes(request)
    return _attached(JSONResponse(rows), f"{as_id(request.path_params['submission_id'])}-episodes.json")


async def _episodes(request: Request) -> list[dict[str, object]]:
    submission_id = as_id(request.path_params["submission_id"])
    viewer = visitor_of(await viewer_of(request))
    detail = await site_of(request).data.submission(viewer, submission_id)
    tasks = load_track(detail.submission.track).tasks
    # A stage's own list has other starts than the track file.
    known = detail.submission.evaluation.commitment is None
    starts = {
        (name, episode.number): " ".join(f"{value:g}" for value in episode.offset)
        for name in detail.submission.tasks
        for episode in tasks[name].episodes
        if known
    }
    return [dict(zip(EPISODE_COLUMNS, _row(end, starts), strict=True)) for end in detail.episodes]


def _row(end: EpisodeView, starts: dict[tuple[str, int], str]) -> tuple[object, ...]:
    start = starts.get((end.task, end.episode), "")
    return (end.task, end.episode, end.shape, start, end.outcome, end.success, end.env_steps)


def _safe(cell: object) -> object:
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(FORMULA_STARTS) and not _is_numbers(cell) else cell


def _is_numbers(text: str) -> bool:
    return all(part.lstrip("-").replace(".", "", 1).isdecimal() for part in text.split(" "))


def _attached(answer: Response, name: str) -> Response:
    answer.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    answer.headers["Cache-Control"] = "no-store"
    return answer
