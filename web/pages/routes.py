"""Mounts the pages on the server's application. Called by `vitac serve`; the server itself does not know the pages."""

import asyncio
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from fastapi import APIRouter, FastAPI
from starlette.datastructures import Headers
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope
from vitac.server.api import by_hand, competitions, judging, members
from vitac.server.api import messages as correspondence
from vitac.server.api import submissions as submission_routes
from vitac.server.api import teams as team_routes
from vitac.server.api.conditional import compressed

from ..documentation.library import ADDRESS, Library
from ..headers import SecurityHeaders
from ..rendering import STATIC, static_digest
from ..site import Page, Site, name_competitions
from . import (
    briefs,
    competition,
    desk,
    episodes,
    errors,
    files,
    home,
    leaderboards,
    messages,
    service,
    teams,
    tracks,
)
from .files import TableFormat
from .forms import form
from .submissions import comparison, sensors, submissions, upload

UPLOADS = (("POST", upload.ADDRESS), ("POST", briefs.OWN))
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


_SUBMISSION = "/submissions/{submission_id}"
_COMPETITION, _DESK = "/competitions/{competition}", "/desk/competitions/{competition}"
_STAGE = f"{_DESK}/tracks/{{track}}/stages/{{stage}}"
FORMS: Mapping[str, Page] = MappingProxyType(
    {
        f"{_COMPETITION}/freeze": form(competitions.freeze),
        f"{_COMPETITION}/unfreeze": form(competitions.unfreeze),
        f"{_DESK}/finalize": form(competitions.finalize, values=desk.read_confirmed),
        f"{_DESK}/reopen": form(competitions.reopen),
        f"{_STAGE}/advance": form(competitions.confirm_advancement, values=desk.read_advancement),
        f"{_STAGE}/reveal": form(competitions.reveal_list),
        f"{_SUBMISSION}/cancel": form(submission_routes.cancel_submission),
        f"{_SUBMISSION}/public": form(submission_routes.put_public, back=f"{_SUBMISSION}#sharing"),
        f"{_SUBMISSION}/chosen": form(submission_routes.put_chosen, back=f"{_SUBMISSION}#final-list"),
        f"{_SUBMISSION}/withdraw": form(submission_routes.put_withdrawal),
        f"{_SUBMISSION}/restore": form(submission_routes.delete_withdrawal),
        f"{_SUBMISSION}/delete": form(submission_routes.delete_submission),
        f"{_SUBMISSION}/description": form(
            submission_routes.put_description,
            back=f"{_SUBMISSION}#about",
            values=lambda fields: {"base": fields.get("base", "")},  # empty: there was no description
        ),
        f"{_SUBMISSION}/description/removal": form(
            submission_routes.put_removal, back=_SUBMISSION, takes_back=submission_routes.delete_removal
        ),
        f"{_SUBMISSION}/clearance": form(
            submission_routes.put_clearance, takes_back=submission_routes.delete_clearance
        ),
        **{
            f"{address}{desk.APPEALS_ADDRESS}/{action}": form(route)
            for address in ("", _COMPETITION)
            for action, route in (("open", correspondence.post_appeal), ("withdraw", correspondence.withdraw_appeal))
        },
        f"{messages.ADDRESS}/ask": form(correspondence.post_question),
        f"{desk.JUDGING_ADDRESS}/marks": form(judging.put_marks, values=desk.read_marks),
        f"{desk.JUDGING_ADDRESS}/conflict": form(judging.post_conflict),
        f"{briefs.ADDRESS}/{{team_id}}/decision": form(
            by_hand.put_decision, back=briefs.ADDRESS, values=briefs.read_decision
        ),
        f"{desk.REJUDGING_ADDRESS}/start": form(judging.post_rejudgement),
        f"{desk.REJUDGING_ADDRESS}/apply": form(judging.apply_rejudgement),
        f"{desk.REJUDGING_ADDRESS}/discard": form(judging.discard_rejudgement),
        f"{desk.ADDRESS}/accept": form(members.change_team, values=lambda _: {"accepted": True}),
        f"{desk.ADDRESS}/refuse": form(members.change_team, values=lambda _: {"accepted": False}),
        f"{desk.ADDRESS}/answer": form(correspondence.put_answer),
        f"{desk.ADDRESS}/hide": form(correspondence.hide_question),
        f"{desk.ADDRESS}/rule": form(correspondence.put_ruling),
        f"{desk.ADDRESS}/announce": form(correspondence.post_announcement),
        f"{desk.ADDRESS}/withdraw": form(correspondence.withdraw_announcement),
        f"{desk.TEAMS_ADDRESS}/bulk": form(team_routes.change_teams, values=desk.read_teams),
        f"{desk.TEAMS_ADDRESS}/note": form(members.put_note),
        f"{teams.ADDRESS}/me": form(members.change_member, ids=teams.own_member, values=teams.read_email),
        f"{teams.ADDRESS}/email": form(members.change_member, ids=teams.own_member),
        f"{teams.ADDRESS}/notices": form(members.change_member, ids=teams.own_member, values=teams.read_muted),
        f"{teams.ADDRESS}/password": form(members.change_member, ids=teams.own_member, values=teams.read_password),
        f"{teams.ADDRESS}/leave": form(members.remove_member, ids=teams.own_member),
        f"{teams.ADDRESS}/remove": form(members.remove_member, ids=teams.own_team),
        f"{teams.ADDRESS}/captain": form(
            members.change_captain, ids=teams.own_team, values=lambda fields: {"member_id": fields.get("id")}
        ),
        f"{teams.ADDRESS}/withdraw": form(members.withdraw_invitation, ids=teams.own_team),
        f"{teams.ADDRESS}/revoke": form(team_routes.delete_token),
    }
)
"""The route of the API that each form calls, by the form's address."""


@cache
def pages() -> APIRouter:
    """Return the pages, which have no state: put together once for all applications of this process."""
    router = APIRouter()
    for path, page, method in (
        ("/", home.home, "GET"),
        ("/example/playback/scene", home.example, "GET"),
        ("/tracks/{track}", leaderboards.leaderboard, "GET"),
        ("/tracks/{track}/leaderboard.csv", files.leaderboard, "GET"),
        ("/tracks/{track}/logs", leaderboards.logs, "GET"),
        ("/tracks/{track}/logs.csv", files.logs, "GET"),
        ("/tracks/{track}/text-logs.csv", files.text_logs, "GET"),
        ("/tracks/{track}/rules", tracks.rules, "GET"),
        ("/competitions", competition.competitions, "GET"),
        ("/competitions/{competition}", competition.competition, "GET"),
        (f"{_COMPETITION}/tracks/{{track}}/stages/{{stage}}/trials", competition.trials, "GET"),
        (f"{_COMPETITION}/tracks/{{track}}/stages/{{stage}}/live/{{station}}", competition.live_picture, "GET"),
        (episodes.TRIAL, episodes.trial, "GET"),
        (f"{episodes.TRIAL}/video", episodes.trial_video, "GET"),
        ("/competitions/{competition}/archive", competition.archive, "GET"),
        ("/competitions/{competition}/receipts", service.receipts, "GET"),
        ("/competitions/{competition}/appeals", desk.list_appeals, "GET"),
        ("/competitions/{competition}/tracks/{track}", leaderboards.leaderboard, "GET"),
        ("/competitions/{competition}/tracks/{track}/leaderboard.csv", files.leaderboard, "GET"),
        ("/competitions/{competition}/tracks/{track}/logs", leaderboards.logs, "GET"),
        ("/competitions/{competition}/tracks/{track}/logs.csv", files.logs, "GET"),
        ("/competitions/{competition}/tracks/{track}/text-logs.csv", files.text_logs, "GET"),
        ("/submissions", submissions.submissions, "GET"),
        ("/submissions.csv", files.submission_list, "GET"),
        (upload.ADDRESS, upload.upload_form, "GET"),
        (upload.ADDRESS, upload.upload, "POST"),
        ("/submissions/{submission_id}", submissions.submission, "GET"),
        *(
            (f"/submissions/{{submission_id}}/{table.name}.{ending}", files.make_table_page(table, ending), "GET")
            for table in files.TABLES
            for ending in TableFormat
        ),
        ("/submissions/{submission_id}/receipt.json", service.receipt_file, "GET"),
        ("/submissions/{submission_id}/compare", comparison.compare_with, "GET"),
        (comparison.ADDRESS, comparison.compare_pages, "GET"),
        (f"{comparison.ADDRESS}.csv", comparison.compare_csv, "GET"),
        (f"{comparison.ADDRESS}.json", comparison.compare_json, "GET"),
        ("/submissions/{submission_id}/output", submissions.output, "GET"),
        ("/submissions/{submission_id}/sensor", sensors.sensor, "GET"),
        ("/submissions/{submission_id}/sensor/shape", sensors.shape, "GET"),
        ("/sensors/reference/shape", sensors.reference_shape, "GET"),
        ("/submissions/{submission_id}/document", sensors.document, "GET"),
        ("/submissions/{submission_id}/events", submissions.events, "GET"),
        ("/submissions/{submission_id}/preview.png", submissions.preview, "GET"),
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
            (episodes.EMBED + address + path, episodes.without_session(page), method)
            for address in EPISODES
            for path, page, method in (
                ("", episodes.embedded, "GET"),
                ("/playback", episodes.playback, "GET"),
                ("/playback", episodes.ask, "POST"),
                ("/playback/{file}", episodes.playback_file, "GET"),
            )
        ),
        ("/operations", service.operations, "GET"),
        ("/register", teams.register_form, "GET"),
        ("/register", teams.register, "POST"),
        (teams.ADDRESS, teams.team, "GET"),
        (f"{teams.ADDRESS}/data.json", teams.data, "GET"),
        (f"{teams.ADDRESS}/invite", teams.invite, "POST"),
        (f"{teams.ADDRESS}/token", teams.renew_token, "POST"),
        (messages.ADDRESS, messages.messages, "GET"),
        (desk.APPEALS_ADDRESS, desk.list_appeals, "GET"),
        (briefs.ADDRESS, briefs.show, "GET"),
        (briefs.OWN, briefs.hand_in, "POST"),
        (f"{briefs.ADDRESS}/{{team_id}}.pdf", briefs.document, "GET"),
        (desk.JUDGING_ADDRESS, desk.judging, "GET"),
        (desk.REJUDGING_ADDRESS, desk.rejudgements, "GET"),
        (desk.TEAMS_ADDRESS, desk.teams, "GET"),
        (f"{desk.TEAMS_ADDRESS}/import", desk.import_file, "POST"),
        ("/desk/competitions/{competition}", desk.competition, "GET"),
        ("/desk/competitions/{competition}/results.zip", desk.results, "GET"),
        *(
            (f"/desk/competitions/{{competition}}/tracks/{{track}}/stages/{{stage}}{path}", page, method)
            for path, page, method in (
                ("", desk.stage, "GET"),
                ("/submissions.zip", desk.submissions, "GET"),
            )
        ),
        (desk.ADDRESS, desk.desk, "GET"),
        ("/join", teams.join_form, "GET"),
        ("/join", teams.join, "POST"),
        ("/sign-in", teams.sign_in_form, "GET"),
        ("/sign-in", teams.sign_in, "POST"),
        ("/sign-in/password", teams.sign_in_with_password, "POST"),
        ("/sign-out", teams.sign_out, "POST"),
        *((path, page, "POST") for path, page in FORMS.items()),
    ):
        router.add_route(path, name_competitions(page), methods=[method], include_in_schema=False)
    return router
