"""Pages of submissions: the list, one with its plots and live updates, its policy's output, and how it is shared."""

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from http import HTTPStatus
from typing import Any, cast
from uuid import UUID

from sqlalchemy.orm import Session
from sse_starlette import ServerSentEvent
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import UnknownTrack, load_track
from vitac.server.api.conditional import answer
from vitac.server.api.streams import CountedStream, OpenStreams
from vitac.server.competitions.view import competition_list_view, track_stages
from vitac.server.database.states import TERMINAL_EVALUATION_STATES, EvaluationState
from vitac.server.errors import TRACK_REMOVED
from vitac.server.leaderboards import public_pages
from vitac.server.playbacks.stills import find_stills, list_stills
from vitac.server.principals import VISITOR
from vitac.server.submissions import listing
from vitac.server.submissions.appeals import takes_appeals
from vitac.server.submissions.files import episode_outputs
from vitac.server.submissions.listing import list_submissions
from vitac.server.submissions.watch import SubmissionWatch
from vitac.server.tracks import known_task
from vitac.server.views.comparisons import StillView
from vitac.server.views.evaluations import TaskProgressView
from vitac.server.views.leaderboards import PastResultView
from vitac.server.views.scores import PracticeScoreView, TaskScoreView
from vitac.server.views.submissions import EpisodeView, RankView, SubmissionListView, SubmissionView

from ...plots.axis import Figure
from ...plots.dates import DatedValue, values_by_date
from ...plots.draws import peak_forces, success_by_draw
from ...plots.episodes import count_outcomes, offset_maps, steps_histogram, success_by_shape
from ...plots.files import find_plot_file
from ...plots.map import EpisodeMap, episode_map, title_of_task
from ...rendering import render
from ...sharing import Citation, cite, draw_preview
from ...site import Site, Tab, Viewer, get_principal, get_site, get_viewer, open_to_all, page, require_viewer
from ..addresses import as_id, board_address, board_query
from ..leaderboards import find_stage_title
from ..submission_detail import SubmissionDetail, read_detail
from ..tracks import NO_SCENE, find_scene


@dataclass(frozen=True, kw_only=True)
class TaskPart:
    """What the page shows of one task: progress, episodes, and once complete, score and rank.

    Where the public list is played beside a sealed one, also score and episodes there.
    """

    map: EpisodeMap
    practice: PracticeScoreView | None
    practice_map: EpisodeMap | None
    progress: TaskProgressView | None
    score: TaskScoreView | None
    rank: RankView | None


async def submissions(request: Request) -> Response:
    """List the visitor's submissions."""
    viewer = await require_viewer(request)
    before = request.query_params.get("before")
    cursor, settings = None if before is None else as_id(before), get_site(request).services.settings

    def read(session: Session) -> tuple[SubmissionListView, Mapping[UUID, StillView]]:
        listed = list_submissions(session, settings, viewer.principal, before=cursor)
        return listed, find_stills(session, viewer.principal, [item.id for item in listed.items])

    own_list, stills = await get_site(request).read(read)
    return page(
        request,
        "submissions.html",
        viewer=viewer,
        section="/submissions",
        found=own_list,
        stills=stills,
        pictures={item.id: find_scene(known_task(item.track, item.tasks[0])) for item in own_list.items if item.tasks},
        no_picture=NO_SCENE,
    )


@open_to_all
async def submission(request: Request) -> Response:
    """Show one submission, a public one to everybody; the page updates itself while the evaluation runs."""
    viewer = await get_viewer(request)
    try:
        values = await _values(request, viewer)
    except UnknownTrack:
        return await _page_of_removed_track(request, viewer)
    refresh = request.query_params.get("refresh") != "off"
    view: SubmissionView = values["submission"]
    stages = await get_site(request).read(lambda session: track_stages(session, view.track)) if view.stage else ()
    by, is_complete = get_principal(viewer), view.evaluation.state is EvaluationState.COMPLETED
    stills = await get_site(request).read(lambda session: list_stills(session, by, view.id)) if is_complete else ()
    drawn = figures(get_site(request), view, values["titles"], values["episodes"], values["past"])
    if plot := find_plot_file(request, list_figures(drawn)):
        return plot
    return page(
        request,
        "submission.html",
        viewer=viewer,
        section="/submissions" if values["is_own"] else "",
        refresh=refresh,
        is_known="known" in request.query_params and values["is_own"],
        **drawn,
        stage_title=find_stage_title(stages, view.stage),
        stills=_choose_stills(stills),
        **values,
    )


def _choose_stills(stills: Sequence[StillView]) -> list[StillView]:
    """Return a success and a failure, where there are stills of them."""
    by_success = {still.outcome is EpisodeOutcome.SUCCESS: still for still in reversed(stills)}
    return [by_success[success] for success in (True, False) if success in by_success]


async def _page_of_removed_track(request: Request, viewer: Viewer | None) -> Response:
    """Show what is known of a submission whose track was removed."""
    view = (await _read_detail(request, viewer)).submission
    is_own = viewer is not None and viewer.may_see(view.team.name, view.competition)
    section = "/submissions" if is_own else ""
    active = view.evaluation.state not in TERMINAL_EVALUATION_STATES
    shown: dict[str, Any] = {"submission": view, "is_own": is_own, "active": active, "sentence": TRACK_REMOVED}
    return page(request, "removed.html", viewer=viewer, section=section, status=HTTPStatus.GONE, **shown)


async def events(request: Request) -> Response:
    """Send the live part of a submission's page whenever it changes, and `end` after the last change."""
    viewer = await get_viewer(request)
    if viewer is None:
        return Response(status_code=204)  # stops EventSource from reconnecting
    await _values(request, viewer)  # refuses a submission of another team before the stream starts
    streams = OpenStreams.from_request(request, get_site(request).services)
    return CountedStream(streams, viewer.principal, _views(request))


async def _views(request: Request) -> AsyncIterator[ServerSentEvent]:
    shown, changes = "", cast("SubmissionWatch", request.app.state.changes)
    with changes.of(as_id(request.path_params["submission_id"])) as watched:
        while (viewer := await get_viewer(request)) is not None:
            seen = watched.version
            values = await watched.look(f"page {viewer.principal.account}", partial(_values, request, viewer))
            html = render("submission_live.html", request, viewer=viewer, **values)
            if html != shown:
                shown = html
                yield ServerSentEvent(event="view", data=html)
            if not values["active"]:
                break
            await watched.wait(seen)
    yield ServerSentEvent(event="end", data="")


async def _read_detail(request: Request, viewer: Viewer | None) -> SubmissionDetail:
    site, submission_id = get_site(request), as_id(request.path_params["submission_id"])
    by = get_principal(viewer)
    return await site.read(lambda session: read_detail(session, site.services.settings, by, submission_id))


async def _values(request: Request, viewer: Viewer | None) -> dict[str, Any]:
    detail = await _read_detail(request, viewer)
    view = detail.submission
    track = load_track(view.track)
    listed = (await get_site(request).read(competition_list_view)).items
    titles = {name: title_of_task(track, name) for name in (*view.tasks, *view.evaluation.counted_tasks)}
    return {
        "is_own": viewer is not None and viewer.may_see(view.team.name, view.competition),
        "organizes": viewer is not None and viewer.principal.organizes(view.competition or ""),
        "card": detail.card,
        "shared": await shared(request, viewer, view, track.title),
        "submission": view,
        "track": track,
        "board": board_address(view.competition if len(listed) > 1 else None, view.track),
        "board_query": board_query,
        "competition": next((one for one in listed if one.name == view.competition and len(listed) > 1), None),
        "takes_appeals": await get_site(request).read(lambda session: takes_appeals(session, view.competition)),
        "episodes": detail.episodes,
        "past": detail.past,
        "active": view.evaluation.state not in TERMINAL_EVALUATION_STATES,
        "took": seconds_taken(view),
        "parts": [task_part(get_site(request), detail, name) for name in view.tasks],
        "several": len(view.tasks) + len(view.missing_tasks) > 1,
        "action_matches": detail.action_matches,
        "episodes_with_output": detail.episodes_with_output,
        "titles": titles,
        "counted": [titles[name] for name in view.evaluation.counted_tasks],
        "missing": [titles[name] for name in view.missing_tasks],
    }


def task_part(site: Site, detail: SubmissionDetail, task: str) -> TaskPart:
    """Return the part of the page for one task of a submission; the map of a complete evaluation is cached."""
    view, evaluation = detail.submission, detail.submission.evaluation

    def make_map(ends: Sequence[EpisodeView], folder: str, *, known: bool) -> EpisodeMap:
        of_task = {end.episode: end for end in ends if end.task == task}
        make = partial(
            episode_map,
            view.track,
            task,
            of_task,
            folder=f"/submissions/{view.id}/{folder}/{task}",
            known=known,
            has_ended=evaluation.state in TERMINAL_EVALUATION_STATES,
        )
        is_final = evaluation.state is EvaluationState.COMPLETED
        return site.maps.get((evaluation.id, folder, task, len(of_task)), make) if is_final else make()

    practice = detail.practice_episodes
    return TaskPart(
        map=make_map(detail.episodes, "episodes", known=evaluation.commitment is None),
        practice=next((score for score in evaluation.practice_scores or () if score.task == task), None),
        practice_map=make_map(practice, "practice", known=True) if practice else None,
        progress=next((progress for progress in evaluation.progress.tasks if progress.task == task), None),
        score=next((score for score in evaluation.scores if score.task == task), None),
        rank=view.task_ranks.get(task),
    )


def seconds_taken(view: SubmissionView) -> float | None:
    """Return the duration of the evaluation [s], or None before its end."""
    evaluation = view.evaluation
    if evaluation.started_at is None or evaluation.finished_at is None:
        return None
    return (evaluation.finished_at - evaluation.started_at).total_seconds()


@dataclass(frozen=True, kw_only=True)
class TaskFigures:
    """The plots of one task.

    Attributes:
        title: of the task.
        maps: outcomes by start offset, one for each shape.
        outcomes: those in the maps.
        draws: success against each drawn quantity.
        figures: the others.
    """

    title: str
    maps: Sequence[Figure]
    outcomes: Sequence[EpisodeOutcome]
    draws: Sequence[Figure]
    figures: Sequence[Figure]


def figures(
    site: Site,
    view: SubmissionView,
    titles: dict[str, str],
    episodes: Sequence[EpisodeView],
    past: Sequence[PastResultView],
) -> dict[str, Any]:
    """Return the plots of a complete evaluation, and those of the team's submissions until now.

    The first never change for somebody who sees the same episodes; the others change with the next result of the team.
    """
    if view.evaluation.state is not EvaluationState.COMPLETED:
        return {"plots": (), "history": ()}
    reached = tuple((result.task, result.submission_id, result.value) for result in past)
    return {
        "plots": site.plots.get(
            (view.evaluation.id, len(episodes)),
            lambda: [_draw_task(view, score, titles[score.task], episodes) for score in view.evaluation.scores],
        ),
        "history": site.plots.get((view.id, reached), lambda: _histories(view, titles, past)),
    }


def list_figures(drawn: Mapping[str, Any]) -> list[Figure]:
    """Return all plots that `figures` has made."""
    tasks: Sequence[TaskFigures] = drawn["plots"]
    return [*(each for task in tasks for each in (*task.maps, *task.figures, *task.draws)), *drawn["history"]]


def _draw_task(view: SubmissionView, score: TaskScoreView, title: str, episodes: Sequence[EpisodeView]) -> TaskFigures:
    ends = [end for end in episodes if end.task == score.task]
    # A stage's own list has other starts than the track file, from which the map takes them.
    known = view.evaluation.commitment is None
    return TaskFigures(
        title=title,
        maps=offset_maps(view.track, score.task, {end.episode: end for end in ends}) if known else (),
        outcomes=count_outcomes(ends),
        draws=success_by_draw(view.track, score.task, ends),
        figures=(success_by_shape(score), *_figures_of_episodes(score.task, ends)),
    )


def _figures_of_episodes(task: str, ends: Sequence[EpisodeView]) -> list[Figure]:
    forces = peak_forces(task, ends)
    return [*([steps_histogram(task, ends)] if ends else []), *([forces] if forces else [])]


def _histories(view: SubmissionView, titles: dict[str, str], past: Sequence[PastResultView]) -> list[Figure]:
    """Return the history of the team in each task in which it has more than one result."""
    shown = []
    for task in view.tasks:
        results = [(result, result.value) for result in past if result.task == task and result.value is not None]
        points = [
            DatedValue(
                name=result.submission_name,
                at=result.submitted_at,
                value=value,
                own=result.submission_id == view.id,
            )
            for result, value in results
        ]
        if len(points) > 1:
            shown.append(values_by_date(f"history-{task}", titles[task], points, results[0][0].ranked_by))
    return shown


async def output(request: Request) -> Response:
    """Show the output of a task's episodes, a page of them."""
    viewer = await require_viewer(request)
    submission_id = as_id(request.path_params["submission_id"])
    task, after = request.query_params.get("task"), _number(request.query_params.get("after", "0"))
    settings = get_site(request).services.settings
    view, shown = await get_site(request).ask(
        lambda session: (
            listing.get(session, settings, viewer.principal, submission_id),
            episode_outputs(session, viewer.principal, submission_id, task, after=after),
        )
    )
    track, address = load_track(view.track), f"/submissions/{submission_id}/output"
    return page(
        request,
        "output.html",
        viewer=viewer,
        section="/submissions",
        submission=view,
        shown=shown,
        tabs=[
            Tab(title=track.task(name).title, target=f"{address}?task={name}", current=name == (task or view.tasks[0]))
            for name in view.tasks
        ],
        older=f"{address}?task={task or view.tasks[0]}&after={shown.next_after}",
    )


def _number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise HTTPException(400, f"Expected the number of an episode, got {text!r:.40}.")
    return int(text)


KEPT_S = 300
"""So long others may show a picture without asking for it again [s]."""


@dataclass(frozen=True, kw_only=True)
class Shared:
    """How a submission is shared on its page.

    Attributes:
        address: of its page.
        may_change: whether the visitor decides who sees it.
        is_public: whether everybody sees it now.
        citation: of a complete one.
    """

    address: str
    may_change: bool
    is_public: bool
    citation: Citation | None


async def shared(request: Request, viewer: Viewer | None, view: SubmissionView, track: str) -> Shared:
    """Return how a submission of a track with that title is shared."""
    is_complete = view.evaluation.state is EvaluationState.COMPLETED
    site = get_site(request)
    address = f"{site.address(request)}/submissions/{view.id}"
    is_shown = (
        is_complete
        and view.public
        and view.id in await site.read(lambda session: public_pages.public_among(session, [view.id]))
    )
    return Shared(
        address=address,
        may_change=viewer is not None and viewer.may_change(view.team.name),
        is_public=is_shown,
        citation=cite(view, track, address) if is_complete else None,
    )


@open_to_all
async def preview(request: Request) -> Response:
    """Answer with the picture that a link to a public submission is shown with elsewhere; for everybody the same."""
    site, submission_id = get_site(request), as_id(request.path_params["submission_id"])
    detail = await site.read(lambda session: read_detail(session, site.services.settings, VISITOR, submission_id))
    view, title = detail.submission, load_track(detail.submission.track).title
    shown = f"{view.evaluation.id} {view.played_rank} {len(detail.episodes)} {view.name!r} {view.team.name!r}"
    picture = await asyncio.to_thread(
        site.previews.get, shown, lambda: draw_preview(view, title, detail.episodes, site.preview_font)
    )
    return answer(
        request,
        picture,
        revision=sha256(picture).hexdigest()[:32],
        media_type="image/png",
        headers={"Cache-Control": f"public, max-age={KEPT_S}", "Cross-Origin-Resource-Policy": "cross-origin"},
    )
