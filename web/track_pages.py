"""Public pages of a track: leaderboard and rules."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from starlette.exceptions import HTTPException
from vitac.evaluator.tracks import UnknownTrack, load_track

from .rendering import words
from .site import page, site_of, viewer_of

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from vitac.evaluator.tracks import Track
    from vitac.server.views import LeaderboardEntryView


@dataclass(frozen=True, kw_only=True)
class ShapeColumn:
    """A column of the leaderboard: the rate of one shape of one task."""

    task: str
    shape: str
    title: str


async def home(request: Request) -> Response:
    """Show the leaderboard of the first track."""
    return await _leaderboard(request, site_of(request).tracks[0], section="/")


async def leaderboard(request: Request) -> Response:
    """Show the leaderboard of a track."""
    return await _leaderboard(request, request.path_params["track"], section="")


async def rules(request: Request) -> Response:
    """Show the rules of a track, all read from its file and from the limits in force."""
    track = _track(request.path_params["track"])
    return page(
        request,
        "rules.html",
        viewer=await viewer_of(request),
        section=f"/tracks/{track.name}/rules",
        track=track,
        limits=site_of(request).data.limits(),
    )


def shape_columns(track: Track) -> tuple[ShapeColumn, ...]:
    """Return the per-shape columns; with several tasks a title also names the task."""
    several = len(track.tasks) > 1
    return tuple(
        ShapeColumn(
            task=name, shape=shape, title=f"{task.title}: {words(shape)}" if several else words(shape).capitalize()
        )
        for name, task in track.tasks.items()
        for shape in task.episode_list.shapes
    )


def shape_rates(columns: tuple[ShapeColumn, ...], entry: LeaderboardEntryView) -> list[float | None]:
    """Return the success rates of an entry in the order of the columns; None where it has no episode of that shape."""
    rates = {(score.task, shape.shape): shape.success_rate for score in entry.scores for shape in score.shapes}
    return [rates.get((column.task, column.shape)) for column in columns]


async def _leaderboard(request: Request, name: str, *, section: str) -> Response:
    track = _track(name)
    board = await site_of(request).data.leaderboard(name)
    columns = shape_columns(track)
    return page(
        request,
        "leaderboard.html",
        viewer=await viewer_of(request),
        section=section,
        board=board,
        track=track,
        ranked=[entry for entry in board.entries if entry.rank is not None],
        episodes=sum(len(task.episodes) for task in track.tasks.values()),
        shapes=columns,
        shape_rates=lambda entry: shape_rates(columns, entry),
    )


def _track(name: str) -> Track:
    try:
        return load_track(name)
    except UnknownTrack as error:
        raise HTTPException(404, str(error)) from error
