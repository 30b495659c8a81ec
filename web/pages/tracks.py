"""Public pages of a track: leaderboard and rules."""

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import urlencode
from uuid import UUID

from markupsafe import Markup
from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.envs.maniskill import scenes
from vitac.envs.maniskill.definition import PREFIX, is_maniskill
from vitac.evaluator.agent.protocol.action import ACTION_TYPES
from vitac.evaluator.tracks import Task, Track, UnknownTrack, load_track
from vitac.server.contest.view import competition_list_view, track_stages
from vitac.server.leaderboards.shown import shown_leaderboard
from vitac.server.sharing.public_pages import public_among
from vitac.server.views.leaderboards import LeaderboardEntryView, LeaderboardView

from ..limits import limit_rows, size
from ..plots.dates import DatedRate, rates_by_date
from ..rendering import STATIC, render, steps, words
from ..site import Site, Tab, Viewer, page, principal_of, site_of, viewer_of
from .addresses import board_address, board_data_address, competition_address, contest_in
from .contest.stages import find_stage_title, stage_tabs
from .paging import BoardPage, EntryT, board_page


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture of a task: a static file, its size [px] and what it shows, for whoever does not see it."""

    file: str
    width: int
    height: int
    shows: str


_SCENE = (
    "The gripper's two gels, coloured by stress, hold the part over its target, which is cut open; beside it "
    "the marker flow of both sensors, which a policy observes"
)
PICTURES = {
    "peg-insertion": Picture(file="peg-insertion.png", width=1000, height=570, shows=_SCENE),
    "lock-opening": Picture(file="lock-opening.png", width=1000, height=570, shows=_SCENE),
    "fusion-insertion": Picture(
        file="fusion-insertion.png",
        width=1000,
        height=640,
        shows="Colour, depth with a scale in mm, the two infrared pictures that depth is measured with, and the point "
        "cloud, at one env step",
    ),
}
"""Drawn by `vitac show`, with `--view cameras` where there are any."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a leaderboard: the rate in one task, or in one shape of it."""

    title: str
    task: str
    shape: str | None = None


@dataclass(frozen=True, kw_only=True)
class Cell:
    """An entry's cell in a column; no rate if it lacks the task."""

    rate: float | None = None
    notes: tuple[str, ...] = ()


async def leaderboard(request: Request) -> Response:
    """Show the leaderboard of a track, or with `?task=` and `?stage=` that of a task or stage."""
    track = known_track(request.path_params["track"])
    site, viewer = site_of(request), await viewer_of(request)
    task, stage = request.query_params.get("task"), request.query_params.get("stage")
    contest, query = contest_in(request), board_query(task, stage)
    address = board_address(contest, track.name)

    def read(session: Session) -> tuple[LeaderboardView, BoardPage[LeaderboardEntryView], Collection[UUID]]:
        by = principal_of(viewer)
        board = shown_leaderboard(session, by, track.name, task=task, stage=stage, contest=contest).view
        own_names = viewer.own_names if viewer else ()
        shown = board_page(request, f"{address}{query}", board.entries, own_names)
        return board, shown, public_among(session, [entry.submission_id for entry in shown.entries])

    board, shown, public = await site.read(read)
    stages, others = await site.read(
        lambda session: (track_stages(session, track.name, contest), contest_tabs(session, contest, track.name))
    )
    counted = list(track.tasks.values()) if task is None else [track.tasks[task]]
    return page(
        request,
        "leaderboard.html",
        viewer=viewer,
        section=f"/tracks/{track.name}",
        board=board,
        query=query,
        board_address=address,
        competition=competition_address(contest),
        board_data=board_data_address(contest, track.name),
        contest_tabs=others,
        stage=stage,
        stage_title=find_stage_title(stages, board.stage),
        shown=shown,
        table=_table(request, board, viewer, public, shown.entries),
        dates=_dates(request, board, viewer),
        track=track,
        tabs=tabs(track, task, stage=stage, contest=contest),
        stage_tabs=stage_tabs(stages, board.stage, lambda other: f"{address}{board_query(task, other)}"),
        track_tabs=track_tabs(site, track) if contest is None else (),
        list_kind=board.list_kind.value,
        ranked=sum(entry.rank is not None for entry in board.entries),
        episodes=sum(len(definition.episodes) for definition in counted),
    )


async def rules(request: Request) -> Response:
    """Show the rules of a track, from its file and the limits in force."""
    track, site = known_track(request.path_params["track"]), site_of(request)
    settings = site.services.settings
    return page(
        request,
        "rules.html",
        viewer=await viewer_of(request),
        section=f"/tracks/{track.name}/rules",
        track=track,
        action_types=ACTION_TYPES,
        limits=limit_rows(settings.limits),
        accepts_logs=accepts_logs(track),
        log_size=size(settings.log_bytes),
        track_tabs=track_tabs(site, track, "/rules"),
        pictures={name: found for name, task in track.tasks.items() if (found := find_picture(task))},
    )


def find_picture(task: Task) -> Picture | None:
    """Return the picture of a task; None where it has none."""
    if not is_maniskill(task.env_id):
        return PICTURES.get(task.name)
    file = scenes.file_name(task.env_id.removeprefix(PREFIX))
    if not (STATIC / file).exists():
        return None
    return Picture(file=file, width=scenes.WIDTH, height=scenes.HEIGHT, shows=f"A start of {task.env_id}")


def track_tabs(
    site: Site, shown: Track, page_of_track: str = "", *, has_page: Callable[[Track], bool] = lambda _: True
) -> tuple[Tab, ...]:
    """Return the same page of every track that has it; empty if there is only one."""
    tracks = [track for track in map(known_track, site.tracks) if has_page(track)]
    if len(tracks) == 1:
        return ()
    return tuple(
        Tab(title=track.title, target=f"/tracks/{track.name}{page_of_track}", current=track.name == shown.name)
        for track in tracks
    )


def contest_tabs(session: Session, shown: str | None, track: str, page_of_track: str = "") -> tuple[Tab, ...]:
    """Return the same boards of every competition that holds a track; empty if there is only one."""
    found = [one for one in competition_list_view(session).items if track in one.tracks]
    if len(found) < 2:
        return ()
    current = shown or found[0].name
    return tuple(
        Tab(title=one.title, target=board_address(one.name, track) + page_of_track, current=one.name == current)
        for one in found
    )


def tabs(
    track: Track, task: str | None, *, logs: bool = False, stage: str | None = None, contest: str | None = None
) -> tuple[Tab, ...]:
    """Return the leaderboards of a track: all tasks, each task, and the logs; empty if there is only one."""
    address = board_address(contest, track.name)
    whole = Tab(title="All tasks", target=address + board_query(None, stage), current=task is None and not logs)
    by_task = (
        Tab(title=definition.title, target=address + board_query(name, stage), current=name == task)
        for name, definition in track.tasks.items()
    )
    shown = [whole] if len(track.tasks) == 1 else [whole, *by_task]
    if accepts_logs(track):
        shown.append(Tab(title="Logs", target=f"{address}/logs{board_query(None, stage)}", current=logs))
    return tuple(shown) if len(shown) > 1 else ()


def board_query(task: str | None, stage: str | None) -> str:
    """Return what the address of a board asks for; empty: all tasks, in the stage that opened last."""
    asked = {name: value for name, value in (("task", task), ("stage", stage)) if value}
    return f"?{urlencode(asked)}" if asked else ""


def accepts_logs(track: Track) -> bool:
    """Return whether a track accepts logs of any kind."""
    return any(not kind.form.runs_policy for kind in track.accepts)


def columns(track: Track, task: str | None) -> tuple[Column, ...]:
    """Return the columns beside the ranking's rate: the tasks, or the shapes of the only one."""
    if _is_combined(track, task):
        return tuple(Column(title=definition.title, task=name) for name, definition in track.tasks.items())
    only = track.tasks[task or next(iter(track.tasks))]
    return tuple(
        Column(title=words(shape).capitalize(), task=only.name, shape=shape) for shape in only.episode_list.shapes
    )


def cells(shown: tuple[Column, ...], entry: LeaderboardEntryView) -> list[Cell]:
    """Return an entry's cells in the columns."""
    return [_cell(column, entry) for column in shown]


def _cell(column: Column, entry: LeaderboardEntryView) -> Cell:
    score = next((score for score in entry.scores if score.task == column.task), None)
    if score is None:
        return Cell(notes=("not submitted",))
    if column.shape is None:
        notes = (f"{score.successes} of {score.episodes}",)
        return Cell(
            rate=score.success_rate,
            notes=notes if score.mean_steps is None else (*notes, f"{steps(score.mean_steps)} env steps"),
        )
    return Cell(rate=next((part.success_rate for part in score.shapes if part.shape == column.shape), None))


def _is_combined(track: Track, task: str | None) -> bool:
    return task is None and len(track.tasks) > 1


def _dates(request: Request, board: LeaderboardView, viewer: Viewer | None) -> Markup:
    """Return the plot of ranked entries against dates, cached until the board changes; nothing for a single one."""
    ranked = [entry for entry in board.entries if entry.rank is not None]
    if len(ranked) < 2:
        return Markup()
    own = next((entry.team for entry in ranked if viewer is not None and entry.team in viewer.own_names), None)

    def make() -> str:
        rates = [
            DatedRate(name=entry.team, at=entry.submitted_at, success_rate=entry.success_rate, own=entry.team == own)
            for entry in ranked
        ]
        return render("board_dates.html", request, figure=rates_by_date("dates", "Success rate against date", rates))

    return site_of(request).plots.get((board.track, board.task, board.revision, own), make)


def _table(
    request: Request,
    board: LeaderboardView,
    viewer: Viewer | None,
    public: Collection[UUID],
    entries: Sequence[LeaderboardEntryView],
) -> Markup:
    """Return entries as a table; the public ones are links for everybody."""
    track = known_track(board.track)
    shown, combined = columns(track, board.task), _is_combined(track, board.task)

    def values(entry: LeaderboardEntryView) -> dict[str, object]:
        return {"combined": combined, "columns": shown, "cells": cells(shown, entry)}

    rows = entry_rows(
        request,
        viewer,
        public,
        "leaderboard_row.html",
        entries,
        values,
        of=lambda entry: (board.task, entry.rank, entry.rank_range),
    )
    return Markup(  # noqa: S704 - a rendered template, whose values are escaped
        render("leaderboard_table.html", request, board=board, combined=combined, columns=shown, rows=rows)
    )


def entry_rows(
    request: Request,
    viewer: Viewer | None,
    public: Collection[UUID],
    template: str,
    entries: Sequence[EntryT],
    values: Callable[[EntryT], Mapping[str, object]] = lambda _: {},
    *,
    of: Callable[[EntryT], Hashable] = lambda _: None,
) -> Markup:
    """Return the rows of entries, each as it was last rendered for somebody who sees the same of it.

    Args:
        request: the request being answered.
        viewer: who sees them.
        public: submissions that everybody may see.
        template: of a row.
        entries: each with what identifies it.
        values: what the template shows of an entry beside it.
        of: what else the row of an entry depends on.
    """
    fragments = site_of(request).fragments
    own_names = viewer.own_names if viewer is not None else ()

    def row(entry: EntryT) -> Markup:
        own = entry.team in own_names
        linked = entry.submission_id in public or (viewer is not None and viewer.may_see(entry.team))
        return fragments.get(
            (template, of(entry), entry.evaluation_id, entry.team, own, linked),
            lambda: render(template, request, entry=entry, own=own, linked=linked, **values(entry)),
        )

    return Markup("".join(map(row, entries)))  # noqa: S704 - rendered templates, whose values are escaped


def known_track(name: str) -> Track:
    """Return a track.

    Raises:
        HTTPException: 404, there is none of that name.
    """
    try:
        return load_track(name)
    except UnknownTrack as error:
        raise HTTPException(404, str(error)) from error
