"""Stages and the end of a competition for its organizers: who advances, the sealed list, all submissions, winners."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.api import competitions as routes
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.stages import Stage
from vitac.server.competitions.view import competition_view
from vitac.server.decisions.advancement import propose
from vitac.server.errors import ServiceError
from vitac.server.principals import Principal
from vitac.server.submissions.stage_files import list_files
from vitac.server.views.competition import CompetitionView

from ..site import get_site, page, require_viewer
from .forms import fetch, list_ticked

_PROPOSED, _TAKEN, _CONCERN = "proposed-", "take-", "confirm-"
"""What the names of fields begin with: teams that advance by the rule, ticked teams, confirmed concerns."""


async def competition(request: Request) -> Response:
    """Show who would win, and what ends, publishes and reopens a competition.

    Raises:
        ServiceError: the visitor does not organize it.
    """
    viewer, site, name = await require_viewer(request), get_site(request), request.path_params["competition"]
    by = viewer.principal

    def read(session: Session) -> CompetitionView:
        return competition_view(session, Competition.find_organized(session, by, name).name)

    view = await site.read(read)
    end, refusal = await _try_end(request, by, view)
    return page(request, "desk_competition.html", viewer=viewer, section="/desk", found=view, end=end, refusal=refusal)


async def _try_end(request: Request, by: Principal, view: CompetitionView) -> tuple[routes.Winners | None, str | None]:
    """Return how the competition would end, or has ended, and why it cannot."""
    services = get_site(request).services
    final = view.finalized_at is not None
    try:
        if final:
            return await get_site(request).run(lambda: routes.get_winners(services, by, view.name)), None
        trial = services.make_trial()
        return await get_site(request).run(lambda: routes.finalize(trial, by, view.name, routes.FinalEnd())), None
    except ServiceError as error:
        return None, error.detail


def read_confirmed(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return the concerns that a form confirms."""
    return {"confirm": list_ticked(fields, _CONCERN)}


async def results(request: Request) -> Response:
    """Download the results as they are published: JSON, CSV, a page to print and certificates."""
    answer = await fetch(request, routes.get_results)
    answer.headers["Content-Disposition"] = f'attachment; filename="{request.path_params["competition"]}-results.zip"'
    return answer


async def stage(request: Request) -> Response:
    """Show all submissions of a stage, who takes part in it, and its sealed list.

    Raises:
        ServiceError: the visitor does not organize its competition.
    """
    viewer = await require_viewer(request)
    by = viewer.principal

    def read(session: Session) -> dict[str, Any]:
        stage = _find_stage(session, by, request)
        listed = stage.sealed_list
        return {
            "stage": stage.rules,
            "title": stage.track_rules.title,
            "over": stage.is_over(datetime.now(UTC)),
            "files": list_files(session, by, stage),
            "proposal": propose(session, by, stage) if stage.rules.qualified is not None else None,
            "sealed": listed,
        }

    shown = await get_site(request).ask(read)
    return page(request, "desk_stage.html", viewer=viewer, section="/desk", here=request.url.path, **shown)


def _find_stage(session: Session, by: Principal, request: Request) -> Stage:
    place = request.path_params
    return Competition.find_organized(session, by, place["competition"]).stage(place["track"], place["stage"])


def read_advancement(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return how the ticked teams differ from those that advance by the rule."""
    proposed, taken = list_ticked(fields, _PROPOSED), list_ticked(fields, _TAKEN)
    return {
        "add": [team for team in taken if team not in proposed],
        "without": [team for team in proposed if team not in taken],
    }


async def submissions(request: Request) -> Response:
    """Download all submissions of a stage."""
    return await fetch(request, routes.get_stage_submissions)
