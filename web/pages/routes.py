"""Mounts the pages on the server's application. Called by `vitac serve`; the server itself does not know the pages."""

import asyncio
from functools import cache

from fastapi import APIRouter, FastAPI
from starlette.datastructures import Headers
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope
from vitac.server.api.conditional import compressed

from ..documentation.library import ADDRESS, Library
from ..headers import SecurityHeaders
from ..rendering import STATIC, static_digest
from ..site import Site, name_competitions
from . import competition, desk, desk_competitions, desk_teams, errors, home, messages, service, tracks
from .episodes import embedded
from .episodes import page as episodes
from .files import boards
from .files import submissions as tables
from .files.formats import TableFormat
from .leaderboards import leaderboard
from .submissions import comparison, output, sensors, sharing, submissions, upload
from .teams import sign_in, team

UPLOADS = (("POST", upload.ADDRESS),)
"""Pages that take uploads, which have limits of their own."""
EPISODES = tuple(f"/submissions/{{submission_id}}/{folder}/{{task}}/{{number}}" for folder in episodes.FOLDERS)
ONE_YEAR_S = 365 * 24 * 3600
TEXT = (".js", ".css", ".svg")
"""Ends of the names of static files that are worth compressing."""


class VersionedStaticFiles(StaticFiles):
    """Static files that browsers may cache for ever when requested with their digest (`?v=`)."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with the file and its cache headers."""
        answer = await super().get_response(path, scope)
        is_asked = scope["query_string"].startswith(b"v=") and answer.status_code == 200
        # A page from before an upgrade may name a digest that its file no longer has.
        versioned = is_asked and scope["query_string"] == f"v={static_digest(path)}".encode()
        answer.headers["Cache-Control"] = f"public, max-age={ONE_YEAR_S}, immutable" if versioned else "no-cache"
        if versioned and isinstance(answer, FileResponse) and path.endswith(TEXT):
            caching = {"Cache-Control": answer.headers["Cache-Control"]}
            content = await asyncio.to_thread((STATIC / path).read_bytes)
            return compressed(Headers(scope=scope), content, media_type=str(answer.media_type), headers=caching)
        return answer


def install(app: FastAPI, site: Site) -> None:
    """Add pages, static files, error pages and security headers to an application."""
    app.state.site = site
    app.state.library = Library(describe_api=app.openapi)
    app.router.routes.extend(pages().routes)
    app.mount("/static", VersionedStaticFiles(directory=STATIC), name="static")
    app.add_middleware(SecurityHeaders)
    errors.install(app)


@cache
def pages() -> APIRouter:
    """Return the pages, which have no state: put together once for all applications of this process."""
    router = APIRouter()
    for path, page, method in (
        ("/", home.home, "GET"),
        ("/example/playback/scene", home.example, "GET"),
        ("/tracks/{track}", leaderboard.leaderboard, "GET"),
        ("/tracks/{track}/leaderboard.csv", boards.leaderboard, "GET"),
        ("/tracks/{track}/logs", leaderboard.logs, "GET"),
        ("/tracks/{track}/logs.csv", boards.logs, "GET"),
        ("/tracks/{track}/text-logs.csv", boards.text_logs, "GET"),
        ("/tracks/{track}/rules", tracks.rules, "GET"),
        ("/competitions", competition.competitions, "GET"),
        ("/competitions/{competition}", competition.competition, "GET"),
        ("/competitions/{competition}/archive", competition.archive, "GET"),
        ("/competitions/{competition}/freeze", competition.freeze, "POST"),
        ("/competitions/{competition}/unfreeze", competition.unfreeze, "POST"),
        ("/competitions/{competition}/receipts", service.receipts, "GET"),
        ("/competitions/{competition}/appeals", desk.list_appeals, "GET"),
        ("/competitions/{competition}/appeals/open", desk.open_appeal, "POST"),
        ("/competitions/{competition}/appeals/withdraw", desk.withdraw, "POST"),
        ("/competitions/{competition}/tracks/{track}", leaderboard.leaderboard, "GET"),
        ("/competitions/{competition}/tracks/{track}/leaderboard.csv", boards.leaderboard, "GET"),
        ("/competitions/{competition}/tracks/{track}/logs", leaderboard.logs, "GET"),
        ("/competitions/{competition}/tracks/{track}/logs.csv", boards.logs, "GET"),
        ("/competitions/{competition}/tracks/{track}/text-logs.csv", boards.text_logs, "GET"),
        ("/submissions", submissions.submissions, "GET"),
        ("/submissions.csv", tables.submission_list, "GET"),
        (upload.ADDRESS, upload.upload_form, "GET"),
        (upload.ADDRESS, upload.upload, "POST"),
        ("/submissions/{submission_id}", submissions.submission, "GET"),
        *(
            (f"/submissions/{{submission_id}}/{table.name}.{form}", tables.make_table_page(table, form), "GET")
            for table in tables.TABLES
            for form in TableFormat
        ),
        ("/submissions/{submission_id}/receipt.json", service.receipt_file, "GET"),
        ("/submissions/{submission_id}/compare", comparison.compare_with, "GET"),
        (comparison.ADDRESS, comparison.compare_pages, "GET"),
        (f"{comparison.ADDRESS}.csv", comparison.compare_csv, "GET"),
        (f"{comparison.ADDRESS}.json", comparison.compare_json, "GET"),
        ("/submissions/{submission_id}/output", output.output, "GET"),
        ("/submissions/{submission_id}/sensor", sensors.sensor, "GET"),
        ("/submissions/{submission_id}/sensor/shape", sensors.shape, "GET"),
        ("/sensors/reference/shape", sensors.reference_shape, "GET"),
        ("/submissions/{submission_id}/document", sensors.document, "GET"),
        ("/submissions/{submission_id}/events", submissions.events, "GET"),
        ("/submissions/{submission_id}/cancel", sharing.cancel, "POST"),
        ("/submissions/{submission_id}/public", sharing.set_public, "POST"),
        ("/submissions/{submission_id}/chosen", sharing.set_chosen, "POST"),
        ("/submissions/{submission_id}/withdraw", sharing.set_withdrawn, "POST"),
        ("/submissions/{submission_id}/restore", sharing.set_withdrawn, "POST"),
        ("/submissions/{submission_id}/delete", sharing.delete, "POST"),
        ("/submissions/{submission_id}/description", sharing.describe, "POST"),
        ("/submissions/{submission_id}/description/removal", sharing.set_removal, "POST"),
        ("/submissions/{submission_id}/clearance", sharing.set_clearance, "POST"),
        ("/submissions/{submission_id}/preview.png", sharing.preview, "GET"),
        ("/competition", competition.competition, "GET"),
        ("/receipts", service.receipts, "GET"),
        ("/competition/archive", competition.archive, "GET"),
        ("/sandbox", service.sandbox, "GET"),
        ("/status", service.status, "GET"),
        (f"{ADDRESS}search", service.search, "GET"),
        (f"{ADDRESS}{{name:path}}", service.documentation, "GET"),
        *(
            (address + path, page, method)
            for address in EPISODES
            for path, page, method in (
                ("", episodes.episode, "GET"),
                ("/playback", episodes.playback, "GET"),
                ("/playback", episodes.ask, "POST"),
                ("/playback/{file}", episodes.playback_file, "GET"),
            )
        ),
        *(
            (episodes.EMBED + address + path, embedded.without_session(page), method)
            for address in EPISODES
            for path, page, method in (
                ("", embedded.embedded, "GET"),
                ("/playback", episodes.playback, "GET"),
                ("/playback", episodes.ask, "POST"),
                ("/playback/{file}", episodes.playback_file, "GET"),
            )
        ),
        ("/operations", service.operations, "GET"),
        ("/register", sign_in.register_form, "GET"),
        ("/register", sign_in.register, "POST"),
        (team.ADDRESS, team.team, "GET"),
        (f"{team.ADDRESS}/data.json", team.data, "GET"),
        (f"{team.ADDRESS}/invite", team.invite, "POST"),
        (f"{team.ADDRESS}/token", team.renew_token, "POST"),
        (f"{team.ADDRESS}/password", team.change_password, "POST"),
        (f"{team.ADDRESS}/{{action}}", team.change, "POST"),
        (messages.ADDRESS, messages.messages, "GET"),
        (f"{messages.ADDRESS}/ask", messages.ask, "POST"),
        (desk.APPEALS_ADDRESS, desk.list_appeals, "GET"),
        (f"{desk.APPEALS_ADDRESS}/open", desk.open_appeal, "POST"),
        (f"{desk.APPEALS_ADDRESS}/withdraw", desk.withdraw, "POST"),
        (desk.JUDGING_ADDRESS, desk.judging, "GET"),
        (f"{desk.JUDGING_ADDRESS}/marks", desk.give_marks, "POST"),
        (f"{desk.JUDGING_ADDRESS}/conflict", desk.declare_conflict, "POST"),
        (desk.REJUDGING_ADDRESS, desk.rejudgements, "GET"),
        (f"{desk.REJUDGING_ADDRESS}/start", desk.start, "POST"),
        (f"{desk.REJUDGING_ADDRESS}/apply", desk.apply, "POST"),
        (f"{desk.REJUDGING_ADDRESS}/discard", desk.discard, "POST"),
        (desk_teams.ADDRESS, desk_teams.teams, "GET"),
        (f"{desk_teams.ADDRESS}/bulk", desk_teams.change_several, "POST"),
        (f"{desk_teams.ADDRESS}/note", desk_teams.change_note, "POST"),
        (f"{desk_teams.ADDRESS}/import", desk_teams.import_file, "POST"),
        ("/desk/competitions/{competition}", desk_competitions.competition, "GET"),
        ("/desk/competitions/{competition}/finalize", desk_competitions.change, "POST"),
        ("/desk/competitions/{competition}/reopen", desk_competitions.change, "POST"),
        ("/desk/competitions/{competition}/results.zip", desk_competitions.results, "GET"),
        *(
            (f"/desk/competitions/{{competition}}/tracks/{{track}}/stages/{{stage}}{path}", page, method)
            for path, page, method in (
                ("", desk_competitions.stage, "GET"),
                ("/advance", desk_competitions.advance, "POST"),
                ("/reveal", desk_competitions.reveal, "POST"),
                ("/submissions.zip", desk_competitions.submissions, "GET"),
            )
        ),
        (desk.ADDRESS, desk.desk, "GET"),
        (f"{desk.ADDRESS}/{{action}}", desk.change, "POST"),
        ("/join", team.join_form, "GET"),
        ("/join", team.join, "POST"),
        ("/sign-in", sign_in.sign_in_form, "GET"),
        ("/sign-in", sign_in.sign_in, "POST"),
        ("/sign-in/password", sign_in.sign_in_with_password, "POST"),
        ("/sign-out", sign_in.sign_out, "POST"),
    ):
        router.add_route(path, name_competitions(page), methods=[method], include_in_schema=False)
    return router
