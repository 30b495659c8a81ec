"""The service below a path of its address: every link, form, script, redirect and cookie stays below it."""

import re
from collections.abc import Iterator
from html.parser import HTMLParser

import pytest
from asgi_browser import AsgiBrowser
from seeded_site import seeded_site
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from vitac.web.application import PublicPath

ADDRESSES = re.compile(r"href|src|action|formaction|poster|data-[a-z-]+")


class Addresses(HTMLParser):
    """All addresses in a page that begin at the root of the host."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [
            value for name, value in attrs if ADDRESSES.fullmatch(name) and (value or "").startswith("/") and value
        ]


@pytest.fixture(scope="module")
def below() -> Iterator[AsgiBrowser]:
    """The service as its public address tells."""
    with seeded_site(public_url="https://example.org/arena/") as site:
        yield site.visitor()


@pytest.mark.parametrize("prefix", ["", "/arena"], ids=["proxy strips it", "proxy leaves it"])
@pytest.mark.parametrize("page", ["/", "/sign-in", "/tracks/track_1", "/tracks/track_1/rules", "/compare"])
def test_every_address_of_every_page_lies_below_the_path(below: AsgiBrowser, page: str, prefix: str) -> None:
    addresses = Addresses()
    addresses.feed(below.get(prefix + page, headers={"accept-encoding": "gzip"}).text)
    assert addresses.found
    assert [found for found in addresses.found if not found.startswith("/arena/")] == []
    style = next(found for found in addresses.found if ".css" in found)
    assert below.get(style).headers["content-type"].startswith("text/css")


async def redirect(_: Request) -> Response:
    answer = RedirectResponse("/team", status_code=303)
    answer.set_cookie("session", "1")
    return answer


async def stream(_: Request) -> Response:
    return StreamingResponse(iter([b'data: <a href="/team">\n\n', b"data: \n\n"]), media_type="text/event-stream")


async def elsewhere(_: Request) -> Response:
    return Response('<a href="//other.example/"><a href="https://x/y"><input value="/team">', media_type="text/html")


def test_redirects_cookies_and_streams_follow_and_others_addresses_stay() -> None:
    routes = [Route("/redirect", redirect), Route("/stream", stream), Route("/elsewhere", elsewhere)]
    browser = AsgiBrowser(PublicPath(Starlette(routes=routes), path="/arena"))
    answer = browser.get("/arena/redirect")
    assert answer.headers["location"] == "/arena/team"
    assert "; path=/arena;" in answer.headers["set-cookie"].lower() + ";"
    assert browser.get("/stream").text == 'data: <a href="/arena/team">\n\ndata: \n\n'
    assert browser.get("/elsewhere").text == '<a href="//other.example/"><a href="https://x/y"><input value="/team">'
