"""The competition's home page: schedule, tracks, rules, prizes, commitments, winners."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.accounts import messages
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.view import competition_list_view, competition_view
from vitac.server.database.states import OPEN_WORK_STATES
from vitac.server.decisions import entered_results, station_trials
from vitac.server.decisions.publishing import archive_view
from vitac.server.leaderboards.descriptions import descriptions_among
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.views.by_hand import EnteredBoardView
from vitac.server.views.competition import ArchiveView, CompetitionView
from vitac.server.views.correspondence import AnnouncementView
from vitac.server.views.submissions import DescriptionView

from ..front import Countdown
from ..site import get_principal, get_site, get_viewer, open_to_all, page
from .addresses import board_address, competition_address, read_competition_name

N_SAID = 3
"""Number of the newest announcements on the page; all of them have a page of their own."""


async def competitions(request: Request) -> Response:
    """Show all competitions of this service to everybody."""
    listed = (await get_site(request).read(competition_list_view)).items
    return page(request, "competitions.html", viewer=await get_viewer(request), section="/competition", found=listed)


async def competition(request: Request) -> Response:
    """Show a competition to everybody: the one in the address, else the one that opened last.

    Raises:
        ServiceError: there is no such competition.
    """
    competition = read_competition_name(request)

    viewer = await get_viewer(request)
    by = get_principal(viewer)

    def read(
        session: Session,
    ) -> tuple[CompetitionView, Sequence[AnnouncementView], int, dict[tuple[str, str], EnteredBoardView]]:
        shown = competition_view(session, competition)
        said = messages.list_announcements(session, competition=shown.name)
        held = Competition.find(session, shown.name)
        boards = {
            (stage.track, stage.name): entered_results.board(session, stage, by)
            for stage in held.stages
            if stage.rules.entered
        }
        return shown, said, len(competition_list_view(session).items), boards

    view, said, n_competitions, boards = await get_site(request).read(read)
    return page(
        request,
        "competition.html",
        viewer=viewer,
        section="/competition",
        found=view,
        competition_url=competition_address(competition),
        board_address=partial(board_address, competition),
        has_others=n_competitions > 1,
        entered_boards=boards,
        said=said[:N_SAID],
        organizes_service=competition is not None and by.organizes(competition),
        now=(now := datetime.now(UTC)),
        countdowns=list_countdowns(view, now),
    )


@open_to_all
async def trials(request: Request) -> Response:
    """Show the plan of a stage that stations play: a team's own places, all once they are published, and the results.

    Raises:
        ServiceError: there is no such stage, or it has no plan.
    """
    viewer, named = await get_viewer(request), request.path_params
    by = get_principal(viewer)

    def read(session: Session) -> dict[str, Any]:
        held = Competition.find(session, named["competition"], track=named["track"])
        stage = held.stage(named["track"], named["stage"])
        own = station_trials.list_trials(session, by, stage)
        places = station_trials.planned_trials(session, stage)
        return {
            "stage": stage.rules,
            "count": len(places),
            "over": sum(trial.state not in OPEN_WORK_STATES for trial in places),
            "places": own,
            "results": station_trials.summarize(session, by, stage),
            "twins": station_trials.read_twins(session),
            "sees_all": by.organizes(stage.competition) or stage.is_revealed,
        }

    return page(
        request,
        "trials.html",
        viewer=viewer,
        section="/competition",
        competition_url=competition_address(named["competition"]),
        **await get_site(request).ask(read),
    )


@open_to_all
async def live_picture(request: Request) -> Response:
    """Answer with what a station's cameras saw in a running trial, later by the organizer's delay."""
    named = request.path_params
    shown = await get_site(request).ask(
        lambda session: station_trials.find_picture(
            session, named["competition"], named["track"], named["stage"], named["station"]
        )
    )
    return Response(shown.picture, media_type="image/jpeg", headers={"Cache-Control": "no-store"})


def list_countdowns(view: CompetitionView, now: datetime) -> list[Countdown]:
    """Return for each track the end of its open stage, else the start of the next, the earliest first."""
    following: dict[tuple[datetime, bool, str], list[str]] = {}
    for track in view.tracks:
        ends = [(stage.closes, True, stage.title) for stage in track.stages if stage.opens <= now < stage.closes]
        starts = [(stage.opens, False, stage.title) for stage in track.stages if stage.opens > now]
        if coming := ends or starts:
            following.setdefault(min(coming), []).append(track.title)
    return [
        Countdown(tracks=tuple(tracks), stage=stage, closes=closes, moment=moment)
        for (moment, closes, stage), tracks in sorted(following.items())
    ]


async def archive(request: Request) -> Response:
    """Show the archive of a competition to everybody.

    Raises:
        ServiceError: there is no such competition that is final.
    """
    competition = read_competition_name(request)
    viewer = await get_viewer(request)

    def read(session: Session) -> tuple[ArchiveView, Mapping[UUID, DescriptionView]]:
        view = archive_view(session, competition)
        public = public_among(session, [entry.submission_id for board in view.boards for entry in board.entries])
        return view, descriptions_among(session, get_principal(viewer), public)

    view, described = await get_site(request).read(read)
    return page(
        request,
        "archive.html",
        viewer=viewer,
        section="/competition",
        found=view.competition,
        competition_url=competition_address(competition),
        boards=view.boards,
        described=described,
        public_key=view.public_key,
        decided_again_at=view.decided_again_at,
        citation=view.citation,
        titles={track.name: track.title for track in view.competition.tracks},
        stages={(track.name, stage.name): stage.title for track in view.competition.tracks for stage in track.stages},
    )
