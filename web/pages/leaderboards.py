"""A track's leaderboard: its tabs of stages and tasks, its pages of entries, its plots."""

from collections.abc import Callable, Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from typing import Any, Generic, TypeVar
from urllib.parse import urlencode
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.tracks import Track
from vitac.server.competitions.view import competition_list_view, track_stages
from vitac.server.errors import ServiceError
from vitac.server.leaderboards.descriptions import descriptions_among
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.reading import BoardSearch, shown_leaderboard, shown_log_boards, shown_rank_history
from vitac.server.leaderboards.shake_up import list_shake_up
from vitac.server.tracks import is_challenge_track, load_known_track
from vitac.server.views.competition import StageView
from vitac.server.views.leaderboards import (
    BaselineView,
    BoardEntryView,
    LeaderboardEntryView,
    LeaderboardView,
    TeamRanksView,
)
from vitac.server.views.scores import TaskRateView, TaskScoreView, describe_twins

from ..plots.axis import Figure
from ..plots.dates import DatedValue, draw_shake_up, ranks_by_date, success_by_delay, values_by_date
from ..plots.files import find_plot_file
from ..rendering import Same, steps, words
from ..site import Site, Tab, Viewer, get_principal, get_site, get_viewer, page
from .addresses import AskedBoard, board_address, board_data_address, board_query, competition_address

PAGE_ENTRIES = 50
SECTION_ENTRIES = 25
"""Of each board, where a page has several."""


EntryT = TypeVar("EntryT", bound=BoardEntryView)


@dataclass(frozen=True, kw_only=True)
class BoardPage(Generic[EntryT]):
    """Some entries of a board.

    Attributes:
        entries: those of the page.
        number: of the page, from 1.
        pages: how many there are.
        search: what was searched for.
        found: number of entries with that.
        total: number of entries of the whole board.
        own: the visitor's first entry on the whole board.
        own_page: number of the page of all teams that has it.
        size: maximum number of entries of a page.
        address: of the board, with its task.
        parameter: what names the number of the page in an address.
        section: id of the board on its page; empty: it is the whole page.
    """

    entries: Sequence[EntryT]
    number: int
    pages: int
    search: BoardSearch
    found: int
    total: int
    own: EntryT | None
    own_page: int
    size: int
    address: str
    parameter: str
    section: str

    def link(self, number: int) -> str:
        """Return the address of a page of the same search."""
        asked = self.search.query() + ([(self.parameter, str(number))] if number > 1 else [])
        return self._add_query(asked) + (f"#{self.section}" if self.section else "")

    @property
    def own_link(self) -> str:
        """Return the address of the visitor's own row."""
        asked = self._add_query([(self.parameter, str(self.own_page))] if self.own_page > 1 else [])
        return f"{asked}#{self.section or 'own'}"

    def _add_query(self, asked: list[tuple[str, str]]) -> str:
        if not asked:
            return self.address
        return f"{self.address}{'&' if '?' in self.address else '?'}{urlencode(asked)}"


def board_page(
    request: Request, address: str, entries: Sequence[EntryT], own_names: Collection[str], *, section: str = ""
) -> BoardPage[EntryT]:
    """Return the page that a request asks for; one that there is not is the nearest one.

    Args:
        request: with a search, and `page`, or `page-SECTION` of a section.
        address: of the board.
        entries: all of them.
        own_names: under which the visitor's team may be there.
        section: id of the board, where a page has several.

    Raises:
        ServiceError: the search cannot be read.
    """
    parameter = f"page-{section}" if section else "page"
    search = BoardSearch.read(request.query_params)
    matching = search.find(entries)
    size = SECTION_ENTRIES if section else PAGE_ENTRIES
    pages = max(1, -(-len(matching) // size))
    number = min(pages, max(1, _whole(request.query_params.get(parameter, "1"))))
    place = next((place for place, entry in enumerate(entries) if entry.team in own_names), None)
    return BoardPage(
        entries=matching[(number - 1) * size : number * size],
        number=number,
        pages=pages,
        search=search,
        found=len(matching),
        total=len(entries),
        own=None if place is None else entries[place],
        own_page=1 if place is None else place // size + 1,
        size=size,
        address=address,
        parameter=parameter,
        section=section,
    )


def _whole(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 7 else 1


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


def known_track(name: str) -> Track:
    """Return a track.

    Raises:
        HTTPException: 404, there is none of that name.
    """
    try:
        return load_known_track(name)
    except ServiceError as error:
        raise HTTPException(404, error.detail) from error


def accepts_logs(track: Track) -> bool:
    """Return whether a track accepts logs of any kind."""
    return any(not kind.form.runs_policy for kind in track.accepts)


def read_surroundings(
    session: Session, site: Site, track: Track, asked: AskedBoard, *, shown_stage: str | None
) -> dict[str, object]:
    """Return what a page of boards shows around them.

    Args:
        session: database session.
        site: with the tracks.
        track: whose boards are shown.
        asked: which ones.
        shown_stage: the stage that they are of.
    """
    competition, part, stages = asked.competition, asked.part, track_stages(session, track.name, asked.competition)
    has_page = accepts_logs if part else lambda _: True
    of_stages = stage_tabs(stages, shown_stage, asked.address)
    return {
        "section": f"/tracks/{track.name}",
        "track": track,
        "stage": asked.stage,
        "stage_title": find_stage_title(stages, shown_stage),
        "query": asked.query(),
        "board_address": board_address(competition, track.name),
        "board_data": board_data_address(competition, track.name),
        "competition_url": competition_address(competition),
        "track_tabs": () if competition else track_tabs(site, track, part, has_page=has_page),
        "competition_tabs": competition_tabs(session, competition, track.name, part),
        "stage_tabs": of_stages,
        "earlier_stage": next((tab for tab, after in pairwise(of_stages) if after.current), None),
        "tabs": task_tabs(track, asked.task, logs=bool(part), stage=asked.stage, competition=competition),
    }


def find_stage_title(stages: Sequence[StageView], name: str | None) -> str | None:
    """Return the title of a stage; its name where the competition's file has just lost it, None outside of stages."""
    return next((stage.title for stage in stages if stage.name == name), name)


def track_tabs(
    site: Site, shown: Track, page_of_track: str = "", *, has_page: Callable[[Track], bool] = lambda _: True
) -> tuple[Tab, ...]:
    """Return the same page of every track that has it; empty if there is only one."""
    tracks = [track for track in map(known_track, site.tracks) if has_page(track)]
    return _several(
        Tab(
            title=track.title,
            target=f"/tracks/{track.name}{page_of_track}",
            current=track.name == shown.name,
            further=not is_challenge_track(track),
        )
        for track in tracks
    )


def competition_tabs(session: Session, shown: str | None, track: str, page_of_track: str = "") -> tuple[Tab, ...]:
    """Return the same boards of every competition that holds a track; empty if there is only one."""
    holding = [one for one in competition_list_view(session).items if track in one.tracks]
    current = shown or (holding[0].name if holding else None)
    return _several(
        Tab(title=one.title, target=board_address(one.name, track) + page_of_track, current=one.name == current)
        for one in holding
    )


def stage_tabs(stages: Sequence[StageView], shown: str | None, find_address: Callable[[str], str]) -> tuple[Tab, ...]:
    """Return the boards of the stages that have opened, and of the shown one; empty if there is only one.

    Args:
        stages: of the track.
        shown: name of the stage whose board is shown.
        find_address: the address of a stage's board.
    """
    now = datetime.now(UTC)
    return _several(
        Tab(title=stage.title, target=find_address(stage.name), current=stage.name == shown)
        for stage in stages
        if stage.opens <= now or stage.name == shown
    )


def task_tabs(
    track: Track, task: str | None, *, logs: bool = False, stage: str | None = None, competition: str | None = None
) -> tuple[Tab, ...]:
    """Return the leaderboards of a track: all tasks, each task, and the logs; empty if there is only one."""
    address = board_address(competition, track.name)
    shown = [Tab(title="All tasks", target=address + board_query(None, stage), current=task is None and not logs)]
    if len(track.tasks) > 1:
        shown += [
            Tab(title=definition.title, target=address + board_query(name, stage), current=name == task)
            for name, definition in track.tasks.items()
        ]
    if accepts_logs(track):
        shown.append(Tab(title="Logs", target=f"{address}/logs{board_query(None, stage)}", current=logs))
    return _several(shown)


def _several(tabs: Iterable[Tab]) -> tuple[Tab, ...]:
    shown = tuple(tabs)
    return shown if len(shown) > 1 else ()
