"""Tables as files, CSV and JSON: boards, and the episodes of submissions."""

from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from uuid import UUID

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from vitac.evaluator.episodes.records import ContactForces, ForceFigures
from vitac.evaluator.tracks import load_track
from vitac.server.csv_text import csv_text
from vitac.server.leaderboards.reading import shown_leaderboard, shown_log_boards
from vitac.server.principals import Principal
from vitac.server.submissions.listing import list_submissions
from vitac.server.views.board_table import BOARD_COLUMNS, board_table, ranked_cells
from vitac.server.views.leaderboards import LogBoardsView
from vitac.server.views.scores import ShapeScoreView, TaskScoreView
from vitac.server.views.submissions import SubmissionListView, SubmissionView

from ..site import Page, Site, get_principal, get_site, get_viewer, open_to_all, require_viewer
from .addresses import AskedBoard, as_id
from .submission_detail import SubmissionDetail, read_detail


class TableFormat(StrEnum):
    """How a table is written; the end of the file's name."""

    CSV = "csv"
    """For spreadsheets."""
    JSON = "json"
    """For programs."""


def table_file(form: TableFormat, name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Response:
    """Return a table in one of the formats."""
    if form is TableFormat.CSV:
        return csv_file(name, columns, rows)
    return json_file(name, objects(columns, rows))


def csv_file(name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Response:
    """Return a table as a file."""
    return attached(Response(csv_text([columns, *rows]), media_type="text/csv"), f"{name}.csv")


def json_file(name: str, content: object) -> Response:
    """Return an object or a list as a file."""
    return attached(JSONResponse(content), f"{name}.json")


def objects(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> list[dict[str, object]]:
    """Return an object for each row."""
    return [dict(zip(columns, row, strict=True)) for row in rows]


def attached(answer: Response, name: str) -> Response:
    """Return an answer that browsers store under a name; nobody keeps a copy on the way."""
    answer.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    answer.headers["Cache-Control"] = "no-store"
    return answer


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


Rows = Iterable[tuple[object, ...]]
SCORE_COLUMNS = (
    "task", "shape", "episodes", "successes", "success_rate", "interval_low", "interval_high", "mean_env_steps",
    "peak_force_n", "twin_trials",
)  # fmt: skip
FORCE_COLUMNS = (
    "peak_force_n", "p95_force_n", "impulse_n_s", "peak_gel_force_n", "p95_gel_force_n", "gel_impulse_n_s",
    "over_force_events", "largest_stretch", "high_stretch",
)  # fmt: skip
"""Figures of the held part, of the more loaded gel, and of the episode."""
LIST_COLUMNS = (
    "id", "submission", "team", "kind", "track", "stage", "task", "state", "verdict", "episodes_done",
    "episodes_total", "success_rate", "mean_env_steps", "submitted_at", "digest",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SubmissionTable:
    """A table that the page of a submission shows.

    Attributes:
        name: of the file, after the submission's id.
        columns: their names.
        rows: what it has for a submission.
    """

    name: str
    columns: tuple[str, ...]
    rows: Callable[[SubmissionDetail], Rows]


def make_table_page(table: SubmissionTable, form: TableFormat) -> Page:
    """Return the page that answers with a table of a submission in a format."""

    @open_to_all
    async def answered(request: Request) -> Response:
        submission_id = as_id(request.path_params["submission_id"])
        site, by = get_site(request), get_principal(await get_viewer(request))
        detail = await site.read(lambda session: read_detail(session, site.services.settings, by, submission_id))
        return table_file(form, f"{submission_id}-{table.name}", table.columns, table.rows(detail))

    return answered


def _episodes(detail: SubmissionDetail) -> Rows:
    track = load_track(detail.submission.track)
    # A stage's own list has other starts than the track file.
    known = detail.submission.evaluation.commitment is None
    starts = {
        (name, episode.number): " ".join(f"{value:g}" for value in episode.offset)
        for name in detail.submission.tasks
        for episode in (track.tasks[name].episodes if known and name in track.tasks else ())
    }
    for end in detail.episodes:
        start = starts.get((end.task, end.episode), "")
        yield end.task, end.episode, end.shape, start, end.outcome, end.success, end.env_steps, *_forces(end.forces)


def _forces(forces: ContactForces | None) -> tuple[object, ...]:
    if forces is None:
        return (None,) * len(FORCE_COLUMNS)
    part, gels = forces.part, forces.gels or ()
    return (
        *(part.peak_n, part.p95_n, part.impulse_n_s),
        *(max((getattr(gel, name) for gel in gels), default=None) for name in ForceFigures.model_fields),
        *(forces.over_force_events, forces.largest_stretch, forces.high_stretch),
    )


def _scores(detail: SubmissionDetail) -> Rows:
    for score in detail.submission.evaluation.scores:
        forces, twins = score.forces and score.forces.part.peak_n, sum(score.twins.values())
        yield score.task, None, *_rate(score), score.mean_steps, forces, twins
        for shape in score.shapes:
            yield score.task, shape.shape, *_rate(shape), None, None, None


def _rate(score: TaskScoreView | ShapeScoreView) -> tuple[object, ...]:
    return score.episodes, score.successes, score.success_rate, *score.success_rate_interval


def _history(detail: SubmissionDetail) -> Rows:
    for past in detail.past:
        yield (
            past.task,
            str(past.submission_id),
            past.submission_name,
            past.submitted_at.isoformat(),
            past.success_rate,
            past.ranked_by.name,
            past.value,
        )


TABLES = (
    SubmissionTable(
        name="episodes",
        columns=("task", "episode", "shape", "start", "outcome", "success", "env_steps", *FORCE_COLUMNS),
        rows=_episodes,
    ),
    SubmissionTable(
        name="scores",
        columns=SCORE_COLUMNS,
        rows=_scores,
    ),
    SubmissionTable(
        name="history",
        columns=("task", "submission_id", "submission", "submitted_at", "success_rate", "ranked_by", "value"),
        rows=_history,
    ),
)
"""`scores` has a row without a shape for each task; `history` is for the team only, and empty for others."""


async def submission_list(request: Request) -> Response:
    """Return all submissions that the visitor may see, newest first, a row for each task."""
    viewer = await require_viewer(request)
    site, by = get_site(request), viewer.principal
    first = await _list(site, by, None)
    return attached(StreamingResponse(_pages(site, by, first), media_type="text/csv"), "submissions.csv")


async def _list(site: Site, by: Principal, before: UUID | None) -> SubmissionListView:
    settings = site.services.settings
    return await site.read(lambda session: list_submissions(session, settings, by, before=before))


async def _pages(site: Site, by: Principal, page: SubmissionListView) -> AsyncIterator[str]:
    """Yield the file page by page: there may be many thousands of submissions."""
    yield csv_text([LIST_COLUMNS])
    while True:
        yield csv_text(row for item in page.items for row in _list_rows(item))
        if page.next_before is None:
            return
        page = await _list(site, by, page.next_before)


def _list_rows(item: SubmissionView) -> Rows:
    evaluation = item.evaluation
    scores = {score.task: score for score in evaluation.scores}
    progress = {part.task: part for part in evaluation.progress.tasks}
    for task in item.tasks:
        score, part = scores.get(task), progress.get(task)
        yield (
            item.id,
            item.name,
            item.team.name,
            item.kind,
            item.track,
            item.stage,
            task,
            evaluation.state,
            item.log.verdict if item.log else None,
            part.episodes_done if part else None,
            part.episodes_total if part else None,
            score.success_rate if score else None,
            score.mean_steps if score else None,
            item.submitted_at.isoformat(),
            item.digest,
        )
