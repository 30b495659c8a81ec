"""Pages over a real service in this process: who visits them, signs in with a token, and sends their forms."""

import re
import ssl
from dataclasses import dataclass, field
from typing import Any

from cli_service import CliService
from httpx import Client, Cookies, Response
from service_factories import make_secret
from sqlalchemy import select
from vitac.server.accounts import teams, tokens
from vitac.server.database.models import Team
from vitac.server.database.states import Role
from vitac.server.principals import CONSOLE, Principal

FORM_TOKEN = re.compile(r'name="form_token" value="([^"]+)"')
SECRET = re.compile(r"<code>((?:vitac_|vitac-join-)[\w-]+)</code>")


NO_CERTIFICATES = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


@dataclass(frozen=True, kw_only=True)
class PageVisitor:
    """A browser without a window that keeps its cookies and follows no redirect."""

    address: str
    cookies: Cookies = field(default_factory=Cookies)

    def get(self, path: str) -> Response:
        return self._request("GET", path)

    def post(self, path: str, **options: Any) -> Response:
        return self._request("POST", path, **options)

    def send(self, page: str, target: str, files: Any = None, **fields: str) -> Response:
        """Sends a form of a page, with files where there are any."""
        found = FORM_TOKEN.search(self.get(page).text)
        assert found is not None, f"{page} has no form of a session"
        return self.post(target, data={"form_token": found[1], **fields}, files=files)

    def _request(self, method: str, path: str, **options: Any) -> Response:
        headers = {"accept": "text/html"} | options.pop("headers", {})
        limits: Any = {"timeout": 60.0, "trust_env": False, "verify": NO_CERTIFICATES}
        with Client(base_url=self.address, cookies=self.cookies, **limits) as client:
            answer = client.request(method, path, headers=headers, **options)
            for cookie in list(self.cookies.jar):
                self.cookies.delete(cookie.name)
            self.cookies.update(client.cookies)
            return answer


def secret_in(text: str) -> str:
    """The token or code that a page shows this once."""
    secret = SECRET.search(text)
    assert secret is not None, text
    return secret[1]


def visitor(service: CliService, secret: str | None = None) -> PageVisitor:
    """Somebody who signs in with a token, or does not."""
    made = PageVisitor(address=service.address)
    if secret is not None:
        assert made.post("/sign-in", data={"token": secret}).status_code == 303
    return made


def team_visitor(service: CliService, team: str = "Team A") -> PageVisitor:
    """Somebody with a shared token of a team, which is made where there is none."""
    with service.database.transaction() as session:
        known = session.scalar(select(Team).where(Team.name == team))
        found = known or teams.register(session, CONSOLE, name=team)
        by = Principal(role=Role.TEAM, team_id=found.id, team_name=found.name, leads_team=True)
        secret = make_secret(session, by)
    return visitor(service, secret)


def visitor_of_role(service: CliService, role: Role) -> PageVisitor:
    """An organizer or a judge."""
    with service.database.transaction() as session:
        secret = tokens.issue(session, CONSOLE, role=role, label=role, lifetime=None).secret
    return visitor(service, secret)
