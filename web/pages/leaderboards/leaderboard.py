"""The leaderboard of a track: of all tasks, or of one."""

from collections.abc import Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import Track
from vitac.server.leaderboards.descriptions import descriptions_among
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.reading import shown_leaderboard, shown_log_boards, shown_rank_history
from vitac.server.leaderboards.shake_up import list_shake_up
from vitac.server.views.leaderboards import (
    BaselineView,
    BoardEntryView,
    LeaderboardEntryView,
    LeaderboardView,
    TeamRanksView,
)
from vitac.server.views.scores import TaskRateView, TaskScoreView, describe_twins

from ...plots.axis import Figure
from ...plots.dates import DatedValue, ranks_by_date, values_by_date
from ...plots.delays import success_by_delay
from ...plots.files import find_plot_file
from ...plots.shake_up import draw_shake_up
from ...rendering import Same, steps, words
from ...site import Site, Viewer, get_principal, get_site, get_viewer, page
from ..addresses import AskedBoard, board_address
from .paging import BoardPage, board_page
from .tabs import known_track, read_surroundings

RowT = TypeVar("RowT", LeaderboardEntryView, BaselineView)

PLOTTED = 50
"""Number of teams that the plot against dates shows: each point has a row in the table behind it."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a leaderboard: the rate in one task or shape, the force in one, or what the board ranks by."""

    title: str
    task: str
    shape: str | None = None
    force: str | None = None
    measure: str | None = None


@dataclass(frozen=True, kw_only=True)
class Cell:
    """An entry's cell in a column; no rate if it lacks the task. A text stands in place of a rate."""

    rate: float | None = None
    text: str | None = None
    notes: tuple[str, ...] = ()


async def leaderboard(request: Request) -> Response:
    """Show the leaderboard of a track, or with `?task=` and `?stage=` that of a task or stage."""
    asked, site, viewer = AskedBoard.read(request), get_site(request), await get_viewer(request)
    track, task = known_track(asked.track), asked.task
    by, own_names = get_principal(viewer), viewer.own_names if viewer else frozenset()

    def read(session: Session) -> dict[str, Any]:
        board = shown_leaderboard(
            session, by, track.name, task=task, stage=asked.stage, competition=asked.competition
        ).view
        shown = board_page(request, asked.address(), board.entries, own_names)
        public: Collection[UUID] = public_among(session, [entry.submission_id for entry in shown.entries])
        around = read_surroundings(session, site, track, asked, shown_stage=board.stage)
        ranks = shown_rank_history(session, by, track.name, task=task, stage=asked.stage, competition=asked.competition)
        described = descriptions_among(session, by, public)
        shake_up = list_shake_up(session, board, PLOTTED) if board.list_sentence else []
        values = {"board": board, "shown": shown, "public": public, "described": described, "ranks": ranks}
        return {**values, "shake_up": shake_up, **around}

    values = await site.read(read)
    board: LeaderboardView = values["board"]
    shown_columns = (
        *_measure_columns(board),
        *columns(track, task),
        *_force_columns(track, task, values["shown"].entries),
    )
    counted = list(track.tasks.values()) if task is None else [track.tasks[task]]
    dates, ranks_plot = _dates(site, board, own_names), _draw_ranks(site, board, values["ranks"])
    shake_up = draw_shake_up(values["shake_up"]) if values["shake_up"] else None
    delays = success_by_delay(track, board.entries) if _is_combined(track, task) else []
    if plot := find_plot_file(request, filter(None, (dates, ranks_plot, shake_up, *delays))):
        return plot

    def described(submission_id: UUID) -> str | None:
        description = values["described"].get(submission_id)
        return None if description is None else str(description.model_dump_json())

    return page(
        request,
        "leaderboard.html",
        viewer=viewer,
        own_names=own_names,
        combined=_is_combined(track, task),
        columns=shown_columns,
        baselines=_with_cells(shown_columns, _find_baselines(board, values["shown"])),
        all_baselines=_with_cells(shown_columns, board.baselines),
        rows=[
            (entry, cells, (*row_key(entry, viewer, values["public"]), shown_columns, described(entry.submission_id)))
            for entry, cells in _with_cells(shown_columns, values["shown"].entries)
        ],
        dates=dates,
        ranks_plot=ranks_plot,
        shake_up_plot=shake_up,
        delay_plots=delays,
        list_kind=board.list_kind.value,
        ranked=sum(entry.rank is not None for entry in board.entries),
        twins=describe_twins(score for entry in board.entries for score in entry.scores),
        episodes=sum(len(definition.episodes) for definition in counted),
        **values,
    )


def row_key(entry: BoardEntryView, viewer: Viewer | None, public: Collection[UUID]) -> tuple[Hashable, ...]:
    """Return what the row of an entry depends on, beside its columns: the entry, and what of it the visitor may see."""
    is_shown = entry.submission_id in public or (viewer is not None and viewer.may_see(entry.team))
    return Same(entry), viewer is not None and entry.team in viewer.own_names, is_shown


def _find_baselines(board: LeaderboardView, shown: BoardPage[LeaderboardEntryView]) -> list[BaselineView]:
    """Return the baselines that a page shows; they follow the last entry."""
    return shown.search.find_baselines(board.baselines) if shown.number == shown.pages else []


def _draw_ranks(site: Site, board: LeaderboardView, ranks: Sequence[TeamRanksView]) -> Figure | None:
    """Return the plot of ranks over time, cached until the board changes; None before any rank has changed."""
    if not any(len(team.ranks) > 1 for team in ranks):
        return None

    def make() -> Figure:
        return ranks_by_date("ranks", "Rank against date", ranks, board.generated_at)

    figure: Figure = site.plots.get((board.track, board.task, board.revision, "ranks"), make)
    return figure


def _measure_columns(board: LeaderboardView) -> tuple[Column, ...]:
    """Return a column for each ranking key beside those that every board shows."""
    return tuple(Column(title=key.title, task="", measure=key.name) for key in board.ranking.measures)


def columns(track: Track, task: str | None) -> tuple[Column, ...]:
    """Return the columns beside the ranking's rate: the tasks, or the shapes of the only one."""
    if _is_combined(track, task):
        return tuple(Column(title=definition.title, task=name) for name, definition in track.tasks.items())
    only = track.tasks[task or next(iter(track.tasks))]
    return tuple(
        Column(title=words(shape).capitalize(), task=only.name, shape=shape) for shape in only.episode_list.shapes
    )


def _force_columns(track: Track, task: str | None, entries: Sequence[LeaderboardEntryView]) -> tuple[Column, ...]:
    """Return the force on the held part, on the board of one task where an entry has any; of stations two columns."""
    recorded = any(score.forces for entry in entries for score in entry.scores)
    if _is_combined(track, task) or not recorded:
        return ()
    only = task or next(iter(track.tasks))
    peak = Column(title="Peak force, median", task=only, force="peak_n")
    if all(score.forces is None or score.forces.gel for entry in entries for score in entry.scores):
        return (peak,)
    return peak, Column(title="95th percentile of force, median", task=only, force="p95_n")


def _is_combined(track: Track, task: str | None) -> bool:
    return task is None and len(track.tasks) > 1


def _with_cells(shown: Sequence[Column], rows: Iterable[RowT]) -> list[tuple[RowT, list[Cell]]]:
    return [(row, [_cell(column, row) for column in shown]) for row in rows]


def _cell(column: Column, row: LeaderboardEntryView | BaselineView) -> Cell:
    if column.measure is not None:
        value = row.measures.get(column.measure)
        return Cell(text="–" if value is None else f"{value:.3g}")
    scores: Sequence[TaskRateView] = row.scores
    score = next((score for score in scores if score.task == column.task), None)
    if score is None:
        return Cell(notes=("not submitted",))
    if column.force is not None:
        forces = score.forces if isinstance(score, TaskScoreView) else None
        return Cell(text=f"{getattr(forces.part, column.force):.1f} N" if forces else "–")
    if column.shape is None:
        notes = (f"{score.successes} of {score.episodes}",)
        return Cell(
            rate=score.success_rate,
            notes=notes if score.mean_steps is None else (*notes, f"{steps(score.mean_steps)} env steps"),
        )
    return Cell(rate=next((part.success_rate for part in score.shapes if part.shape == column.shape), None))


def _dates(site: Site, board: LeaderboardView, own_names: Collection[str]) -> Figure | None:
    """Return the plot of what ranks entries against dates, cached until the board changes; None for a single one."""
    all_ranked = [entry for entry in board.entries if entry.rank is not None]
    ranked = [*all_ranked[:PLOTTED], *(entry for entry in all_ranked[PLOTTED:] if entry.team in own_names)]
    ranked_by = board.ranking.compared_first
    read = ((entry, board.ranking.values(entry, entry.submitted_at).get(ranked_by.name)) for entry in ranked)
    values = [(entry, value) for entry, value in read if value is not None]
    if len(values) < 2:
        return None
    own = next((entry.team for entry in ranked if entry.team in own_names), None)

    def make() -> Figure:
        points = [
            DatedValue(name=entry.team, at=entry.submitted_at, value=value, own=entry.team == own)
            for entry, value in values
        ]
        return values_by_date("dates", f"{ranked_by.title} against date", points, ranked_by)

    figure: Figure = site.plots.get((board.track, board.task, board.revision, own), make)
    return figure


TEXT_LOGS = "text-logs"


async def logs(request: Request) -> Response:
    """Show the logs of a track, with `?stage=` of a stage, with `?q=` those of teams with that in their name."""
    asked, site, viewer = AskedBoard.read(request, logs=True), get_site(request), await get_viewer(request)
    track = known_track(asked.track)
    by, own_names = get_principal(viewer), viewer.own_names if viewer else frozenset()
    paged = partial(board_page, request, asked.address(), own_names=own_names)

    def read(session: Session) -> dict[str, Any]:
        boards = shown_log_boards(session, by, track.name, stage=asked.stage, competition=asked.competition).view
        shown = {
            (board.kind, board.task): paged(board.entries, section=f"{board.kind}s-{board.task}")
            for board in boards.boards
        }
        text_logs = paged(boards.text_logs, section=TEXT_LOGS)
        listed = [entry.submission_id for board in shown.values() for entry in board.entries]
        listed += [entry.submission_id for entry in text_logs.entries]
        around = read_surroundings(session, site, track, asked, shown_stage=boards.stage)
        public = public_among(session, listed)
        return {"found": boards, "shown": shown, "text_logs": text_logs, "public": public, **around}

    values = await site.read(read)
    boards = (values["text_logs"], *values["shown"].values())
    return page(
        request,
        "logs.html",
        viewer=viewer,
        own_names=own_names,
        logs_address=board_address(asked.competition, track.name) + asked.part,
        search=values["text_logs"].search,
        row_key=partial(row_key, viewer=viewer, public=values["public"]),
        searchable=any(board.total > board.size for board in boards),
        **values,
    )
