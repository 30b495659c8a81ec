"""Upload a submission with a form; a script shows how far it is."""

from collections.abc import AsyncIterator

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from vitac.evaluator.submission_kinds import kind_of_file
from vitac.server.competitions.view import list_choices
from vitac.server.errors import ServiceError
from vitac.server.limiter import UPLOADS
from vitac.server.principals import Principal
from vitac.server.submissions.intake import AnnouncedUpload
from vitac.server.submissions.upload import receive

from ...headers import size
from ...session import read_file_form
from ...site import Viewer, get_site, page, require_form_token, require_viewer
from ..errors import wants_page

ADDRESS = "/submissions/upload"
NO_FILE = "Choose a file first."


async def upload_form(request: Request) -> Response:
    """Show the form."""
    return await _form(request, await require_viewer(request))


async def upload(request: Request) -> Response:
    """Receive the file and go to its submission; a refusal is shown above the form."""
    viewer = await require_viewer(request)
    form = await read_file_form(request)
    require_form_token(request, form.fields, viewer)
    if not form.file_name:
        return await _form(request, viewer, wrong=NO_FILE, status=422)
    announced = AnnouncedUpload(
        kind=kind_of_file(form.file_name),
        competition=form.fields.get("competition") or None,
        team=form.fields.get("team", "").strip() or None,
        again="again" in form.fields,
        file_name=form.file_name,
    )
    try:
        address = await _receive(request, viewer.principal, announced, form.pieces)
    except ServiceError as error:
        await form.discard()
        if not wants_page(request):
            raise
        return await _form(request, viewer, wrong=error.detail, status=error.status)
    return RedirectResponse(address, status_code=303)


async def _receive(request: Request, by: Principal, announced: AnnouncedUpload, body: AsyncIterator[bytes]) -> str:
    """Return the address of the submission, which says so where the team had submitted it before."""
    services = get_site(request).services
    with request.app.state.upload_limiter.one(by.account, UPLOADS):
        made, is_new = await receive(services, by, announced, body)
    return f"/submissions/{made.id}{'' if is_new else '?known=yes'}"


async def _form(request: Request, viewer: Viewer, *, wrong: str | None = None, status: int = 200) -> Response:
    site = get_site(request)
    settings = site.services.settings
    return page(
        request,
        "upload.html",
        viewer=viewer,
        section="/submissions",
        status=status,
        wrong=wrong,
        competitions=await site.read(list_choices),
        archive_size=size(settings.limits.archive_packed_bytes),
        image_size=size(settings.limits.image_bytes),
        log_size=size(settings.log_bytes),
    )
