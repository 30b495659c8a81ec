"""The archive of a competition that is final: winners, boards as they were, how to cite."""

from collections.abc import Mapping
from uuid import UUID

from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.decisions.publishing import archive_view
from vitac.server.leaderboards.descriptions import descriptions_among
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.views.competition import ArchiveView
from vitac.server.views.submissions import DescriptionView

from ...site import get_principal, get_site, get_viewer, page
from ..addresses import competition_address, read_competition_name


async def archive(request: Request) -> Response:
    """Show the archive of a competition to everybody.

    Raises:
        ServiceError: there is no such competition that is final.
    """
    competition = read_competition_name(request)
    viewer = await get_viewer(request)

    def read(session: Session) -> tuple[ArchiveView, Mapping[UUID, DescriptionView]]:
        found = archive_view(session, competition)
        public = public_among(session, [entry.submission_id for board in found.boards for entry in board.entries])
        return found, descriptions_among(session, get_principal(viewer), public)

    found, described = await get_site(request).read(read)
    return page(
        request,
        "archive.html",
        viewer=viewer,
        section="/competition",
        found=found.competition,
        competition_url=competition_address(competition),
        boards=found.boards,
        described=described,
        public_key=found.public_key,
        decided_again_at=found.decided_again_at,
        citation=found.citation,
        titles={track.name: track.title for track in found.competition.tracks},
        stages={(track.name, stage.name): stage.title for track in found.competition.tracks for stage in track.stages},
    )
