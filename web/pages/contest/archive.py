"""The archive of a competition that is final: winners, boards as they were, how to cite."""

from starlette.requests import Request
from starlette.responses import Response
from vitac.server.publishing.archive import archive_view

from ...site import get_site, get_viewer, page
from ..addresses import competition_address, read_contest_name


async def archive(request: Request) -> Response:
    """Show the archive of a competition to everybody.

    Raises:
        ServiceError: there is no such competition that is final.
    """
    contest = read_contest_name(request)
    found = await get_site(request).read(lambda session: archive_view(session, contest))
    return page(
        request,
        "archive.html",
        viewer=await get_viewer(request),
        section="/competition",
        found=found.competition,
        competition=competition_address(contest),
        boards=found.boards,
        public_key=found.public_key,
        decided_again_at=found.decided_again_at,
        citation=found.citation,
        titles={track.name: track.title for track in found.competition.tracks},
        stages={(track.name, stage.name): stage.title for track in found.competition.tracks for stage in track.stages},
    )
