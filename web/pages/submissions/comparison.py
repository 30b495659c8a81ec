"""Two submissions compared episode by episode, with the exact p-value of McNemar's test."""

from collections.abc import Iterator
from functools import partial

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.scoring.comparison import Comparison, NothingToCompare, compare
from vitac.server.submissions.listing import list_submissions

from ...site import Viewer, get_site, page, require_viewer
from ..addresses import as_id
from ..files.formats import csv_file, json_file, objects
from ..submission_detail import SubmissionDetail, read_detail

COLUMNS = ("task", "episode", "shape", "first_outcome", "first_env_steps", "second_outcome", "second_env_steps")
COUNTS = ("both", "only_first", "only_second", "neither", "unpaired", "p_value")


async def compare_pages(request: Request) -> Response:
    """Show the comparison with the submission that `?with=` names, or a form to choose one."""
    viewer = await require_viewer(request)
    first, second = await _both(request, viewer)
    site = get_site(request)
    newest = await site.read(
        lambda session: list_submissions(
            session, site.services.settings, viewer.principal, track=first.submission.track
        )
    )
    offered = [other for other in newest.items if other.id != first.submission.id and other.evaluation.scores]
    if second and second.submission.id not in {first.submission.id, *(other.id for other in offered)}:
        offered.append(second.submission)
    return page(
        request,
        "comparison.html",
        viewer=viewer,
        section="/submissions",
        first=first.submission,
        second=second.submission if second else None,
        found=_compared(first, second),
        offered=offered,
    )


async def compare_csv(request: Request) -> Response:
    """Return the pairs of episodes as a file."""
    viewer = await require_viewer(request)
    return csv_file("comparison", COLUMNS, _pairs(_compared(*await _both(request, viewer))))


async def compare_json(request: Request) -> Response:
    """Return counts, p-value and pairs of episodes as a file; `result` is null where nothing can be compared."""
    viewer = await require_viewer(request)
    first, second = await _both(request, viewer)
    found = _compared(first, second)
    result = {name: getattr(found, name) for name in COUNTS} if found else None
    return json_file(
        "comparison",
        {
            "first": _named(first),
            "second": _named(second) if second else None,
            "result": result,
            "pairs": objects(COLUMNS, _pairs(found)),
        },
    )


def _named(detail: SubmissionDetail) -> dict[str, str]:
    found = detail.submission
    evaluator = found.evaluation.evaluator_version
    return {"id": str(found.id), "name": found.name, "team": found.team.name, "evaluator_version": evaluator}


def _pairs(found: Comparison | None) -> Iterator[tuple[object, ...]]:
    for pair in found.pairs if found else ():
        first, second = pair.first, pair.second
        ends = (first.outcome, first.env_steps, second.outcome, second.env_steps)
        yield first.task, first.episode, first.shape, *ends


async def _both(request: Request, viewer: Viewer) -> tuple[SubmissionDetail, SubmissionDetail | None]:
    site, named = get_site(request), request.query_params.get("with")
    submission_id, other_id = as_id(request.path_params["submission_id"]), as_id(named) if named else None

    def read(session: Session) -> tuple[SubmissionDetail, SubmissionDetail | None]:
        read_one = partial(read_detail, session, site.services.settings, viewer.principal)
        return read_one(submission_id), read_one(other_id) if other_id else None

    return await site.read(read)


def _compared(first: SubmissionDetail, second: SubmissionDetail | None) -> Comparison | None:
    """Return the comparison; None where there is nothing to compare, also because the lists were not the same."""
    ours, theirs = first.submission, second.submission if second else None
    if second is None or theirs is None or ours.track != theirs.track:
        return None
    if ours.evaluation.commitment != theirs.evaluation.commitment:
        return None
    try:
        return compare(first.episodes, second.episodes)
    except NothingToCompare:
        return None
