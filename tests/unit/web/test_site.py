"""What pages know of their visitor: whose results are shown, what may be changed, where the navigation leads."""

import asyncio
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any, cast
from uuid import UUID

import pytest
from starlette.requests import Request
from starlette.responses import Response
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import VISITOR, Principal
from vitac.web import site
from vitac.web.site import (
    SignInNeeded,
    Site,
    Viewer,
    _find_concerned,
    get_principal,
    navigation,
    open_to_all,
    require_viewer,
    sign_in_first,
)

SITE = cast(Site, SimpleNamespace(tracks=("track_1", "track_2")))


def viewer(
    name: str = "Team A", *, organizer: bool = False, judge: bool = False, competition: str | None = None
) -> Viewer:
    role = Role.ORGANIZER if organizer else Role.JUDGE if judge else Role.TEAM
    team = {"team_id": UUID(int=1), "team_name": name, "team_pseudonym": name} if role is Role.TEAM else {}
    principal = Principal(role=role, competition=competition, token_id=UUID(int=2), **cast(Any, team))
    return Viewer(principal=principal, form_token="token", expires_at=datetime.now(UTC))  # noqa: S106


def request(path: str = "/submissions/1", query: str = "") -> Request:
    return Request({"type": "http", "path": path, "query_string": query.encode(), "headers": [], "method": "GET"})


def targets(who: Viewer | None) -> list[str]:
    return [target for target, _ in navigation(SITE, who)]


def test_navigation_has_what_a_visitor_can_open() -> None:
    everybody = ["/tracks/track_1", "/tracks/track_1/rules", "/docs/"]
    assert targets(None) == everybody
    assert targets(viewer()) == [*everybody, "/submissions", "/team"]
    assert targets(viewer("Judge", judge=True)) == [*everybody, "/submissions", "/judging"]
    assert targets(viewer("Desk", organizer=True)) == [
        *everybody, "/submissions", "/judging", "/desk", "/operations",
    ]  # fmt: skip
    assert targets(viewer("School", organizer=True, competition="class")) == [
        *everybody, "/submissions", "/judging", "/desk",
    ]  # fmt: skip
    labels = [label for _, label in navigation(SITE, viewer("Desk", organizer=True))]
    assert len(set(labels)) == len(labels)


def test_a_team_changes_its_own_an_organizer_everything_a_judge_nothing() -> None:
    assert viewer().may_change("Team A")
    assert not viewer().may_change("Team B")
    assert viewer("Desk", organizer=True).may_change("Team B")
    school = viewer("School", organizer=True, competition="class")
    assert [school.may_see("Team B", competition) for competition in ("class", "cup", None)] == [True, False, False]
    judge = viewer("Judge", judge=True)
    assert judge.may_see("Team B")
    assert not judge.may_change("Team B")
    assert not viewer().may_see("Team B")
    assert get_principal(None) is VISITOR
    assert get_principal(judge) is judge.principal


@pytest.mark.parametrize(
    ("path", "target"),
    [
        ("/submissions/1", "/sign-in?next=/submissions/1"),
        ("/team x&next=//elsewhere", "/sign-in?next=/team%20x%26next%3D//elsewhere"),
    ],
)
def test_who_has_to_sign_in_comes_back_to_where_they_were(path: str, target: str) -> None:
    answer = sign_in_first(request(path), SignInNeeded())
    assert (answer.status_code, answer.headers["location"]) == (303, target)


@pytest.mark.parametrize(
    ("code", "raised"), [(ProblemCode.MISSING_CREDENTIALS, SignInNeeded), (ProblemCode.NOT_FOUND, ServiceError)]
)
def test_only_what_needs_a_token_leads_to_the_sign_in_page(code: ProblemCode, raised: type[Exception]) -> None:
    @open_to_all
    async def show(_: Request) -> Any:
        raise ServiceError(code, "no")

    async def answer() -> Response:
        return await show(request())

    with pytest.raises(raised):
        asyncio.run(answer())
    assert show.__name__ == "show"


def test_a_visitor_is_asked_to_sign_in_before_anything_else_and_a_viewer_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found: list[Viewer | None] = [None, viewer()]

    async def next_viewer(_: Request) -> Viewer | None:
        return found.pop(0)

    monkeypatch.setattr(site, "get_viewer", next_viewer)
    with pytest.raises(SignInNeeded):
        asyncio.run(require_viewer(request()))
    assert asyncio.run(require_viewer(request())).name == "Team A"
    assert not found


@pytest.mark.parametrize(
    ("public_url", "address"),
    [(None, "http://127.0.0.1:81"), ("https://public.example/", "https://public.example")],
)
def test_links_lead_to_the_public_address_or_to_this_machine_whatever_host_the_request_names(
    public_url: str | None, address: str
) -> None:
    asked = Request(
        {"type": "http", "scheme": "http", "path": "/", "headers": [(b"host", b"arena.example:81")], "method": "GET",
         "query_string": b"", "server": ("127.0.0.1", 81)}
    )  # fmt: skip
    assert Site.address(cast(Site, SimpleNamespace(public_url=public_url)), asked) == address


@pytest.mark.parametrize(
    ("path", "n_competitions", "n_concerned"),
    [
        ("/", 2, 2),
        ("/competitions", 2, 2),
        ("/submissions/upload", 1, 1),
        ("/submissions/upload", 2, 0),
        ("/desk", 2, 0),
    ],
)
def test_a_page_of_no_competition_warns_of_the_only_one(path: str, n_competitions: int, n_concerned: int) -> None:
    request: Any = SimpleNamespace(path_params={}, url=SimpleNamespace(path=path))
    competitions: Any = [SimpleNamespace(name=f"cup-{number}") for number in range(n_competitions)]
    assert len(_find_concerned(request, competitions, {})) == n_concerned
