"""The organizers' desk: what waits for them, rejudgements, the stages and ends of competitions, and all teams."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import FigureRow, make_rows, reference_figures
from vitac.server.accounts.team_lists import BulkAction, TeamSearch, list_teams
from vitac.server.api import competitions as routes
from vitac.server.api.teams import import_teams
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.stages import Stage
from vitac.server.competitions.view import competition_list_view, competition_view
from vitac.server.database.models import Rejudgement
from vitac.server.decisions import rejudging
from vitac.server.decisions.advancement import propose
from vitac.server.decisions.judging import sheets
from vitac.server.decisions.rejudging import rejudgement_detail_view, rejudgement_view
from vitac.server.errors import ServiceError
from vitac.server.operations.desk import read_desk
from vitac.server.principals import Principal
from vitac.server.submissions import appeals
from vitac.server.submissions.stage_files import list_files
from vitac.server.views.competition import CompetitionView
from vitac.server.views.teams import TeamState

from ..site import get_site, page, require_viewer, signed_in_form
from .addresses import board_address, competition_address, read_competition_name
from .forms import call, fetch, list_ticked

ADDRESS = "/desk"


async def desk(request: Request) -> Response:
    """Show the desk to an organizer.

    Raises:
        ServiceError: the visitor is none.
    """
    viewer = await require_viewer(request)
    work = await get_site(request).ask(lambda session: read_desk(session, viewer.principal))
    return page(request, "desk.html", viewer=viewer, section=ADDRESS, found=work, board_address=board_address)


REJUDGING_ADDRESS = "/rejudging"


async def rejudgements(request: Request) -> Response:
    """Show open rejudgements with what they would change, and those that have ended.

    Raises:
        ServiceError: the visitor is no organizer.
    """
    viewer, site = await require_viewer(request), get_site(request)

    def read(session: Session) -> dict[str, Any]:
        listed = rejudging.rejudgements(session, viewer.principal)
        competitions = [one for one in Competition.read_all(session) if viewer.principal.organizes(one.name)]
        ended = [one for one in listed if one.applied_at or one.discarded_at]
        open_ones = [rejudgement_detail_view(session, one) for one in listed if one not in ended]
        return {
            "open_ones": open_ones,
            "ended": [rejudgement_view(one) for one in ended],
            "places": {one.id: _place(session, one) for one in listed},
            "titles": {name: Competition.find_by_track(session, name).track_title(name) for name in site.tracks},
            "competitions": competitions if len(competitions) > 1 else [],
        }

    shown = await site.ask(read)
    return page(
        request,
        "rejudging.html",
        viewer=viewer,
        section="/desk",
        tracks=site.tracks,
        **shown,
    )


def _place(session: Session, rejudgement: Rejudgement) -> str:
    """Return in words which stage is evaluated again, with its competition where there are several."""
    competitions = Competition.read_all(session)
    competition = next((one for one in competitions if one.name == rejudgement.competition), None)
    titled = competition or Competition.find_by_track(session, rejudgement.track)
    words = [titled.track_title(rejudgement.track)]
    if competition is not None and len(competitions) > 1:
        words.insert(0, competition.definition.title)
    if rejudgement.stage:
        words.append(titled.stage_titles.get((rejudgement.track, rejudgement.stage), rejudgement.stage))
    return ", ".join(words)


JUDGING_ADDRESS = "/judging"
_MARK = "mark-"
"""What the names of the fields with marks begin with."""


async def judging(request: Request) -> Response:
    """Show the judged tracks to a judge or an organizer.

    Raises:
        ServiceError: the visitor is neither.
    """
    viewer = await require_viewer(request)
    own_sheets = await get_site(request).ask(lambda session: sheets(session, viewer.principal))
    return page(request, "judging.html", viewer=viewer, section=JUDGING_ADDRESS, found=own_sheets, rows=_rows)


def read_marks(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return the marks of a form."""
    return {"marks": {name.removeprefix(_MARK): text for name, text in fields.items() if name.startswith(_MARK)}}


def _rows(figures: SensorFigures) -> list[FigureRow]:
    return list(make_rows(figures, reference_figures()))


APPEALS_ADDRESS = "/appeals"


async def list_appeals(request: Request) -> Response:
    """Show the appeals of the team, all to organizers and judges."""
    viewer = await require_viewer(request)
    by, competition = viewer.principal, read_competition_name(request)
    listed = await get_site(request).ask(lambda session: appeals.visible(session, by, competition))
    is_taken = await get_site(request).read(lambda session: appeals.takes_appeals(session, competition))
    given = request.query_params.get("submission", "")
    return page(
        request,
        "appeals.html",
        viewer=viewer,
        section=APPEALS_ADDRESS,
        found=listed,
        is_taken=is_taken,
        submission=given,
        appeals_address=_address(request),
    )


def _address(request: Request) -> str:
    competition = read_competition_name(request)
    return APPEALS_ADDRESS if competition is None else f"{competition_address(competition)}{APPEALS_ADDRESS}"


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


TEAMS_ADDRESS = "/desk/teams"
_TEAM = "team-"


async def teams(request: Request) -> Response:
    """Show the teams that a search finds to an organizer of the service.

    Raises:
        ServiceError: the visitor is none.
    """
    viewer, query = await require_viewer(request), request.query_params
    state = query.get("state", "")
    search = TeamSearch(
        text=query.get("q", "").strip()[:64],
        state=TeamState(state) if state in set(TeamState) else None,
        competition=query.get("competition") or None,
    )

    def read(session: Session) -> dict[str, Any]:
        return {
            "found": list_teams(session, viewer.principal, search),
            "competitions": competition_list_view(session).items,
        }

    shown = await get_site(request).read(read)
    return page(
        request,
        "desk_teams.html",
        viewer=viewer,
        section="/desk",
        search=search,
        states=list(TeamState),
        actions=list(BulkAction),
        **shown,
    )


def read_teams(fields: Mapping[str, str]) -> Mapping[str, object]:
    """Return the ticked teams."""
    return {"teams": list_ticked(fields, _TEAM)}


async def import_file(request: Request) -> Response:
    """Add the teams of a pasted CSV file, and show the invitations once."""
    viewer, fields = await signed_in_form(request)
    made = await call(request, import_teams, viewer.principal, fields)
    return page(request, "desk_imported.html", viewer=viewer, section="/desk", status=201, made=made)
