import asyncio
from collections.abc import Sequence
from typing import Any

from starlette.types import Message, Receive, Scope, Send
from vitac.web.headers import HEADERS, SecurityHeaders


def sent(kind: str = "http", headers: Sequence[tuple[bytes, bytes]] = ()) -> list[Message]:
    """What leaves the server where the application answers with these headers and a body."""
    messages: list[Message] = []

    async def app(_: Scope, __: Receive, send: Send) -> None:
        await send({"type": f"{kind}.response.start", "status": 200, "headers": list(headers)})
        await send({"type": f"{kind}.response.body", "body": b"x"})

    async def receive() -> Message:
        return {"type": f"{kind}.request"}

    async def keep(message: Message) -> None:
        messages.append(message)

    asyncio.run(SecurityHeaders(app)({"type": kind}, receive, keep))
    return messages


def headers_of(message: Any) -> dict[str, str]:
    return {name.decode(): value.decode() for name, value in message["headers"]}


def test_an_answer_gets_every_header_and_keeps_its_body() -> None:
    start, body = sent()
    assert headers_of(start) == {name.lower(): value for name, value in HEADERS.items()}
    assert body == {"type": "http.response.body", "body": b"x"}


def test_a_header_of_the_answer_itself_stays() -> None:
    start, _ = sent(headers=[(b"content-security-policy", b"default-src 'self'"), (b"etag", b"1")])
    assert headers_of(start)["content-security-policy"] == "default-src 'self'"
    assert headers_of(start)["etag"] == "1"
    assert len(start["headers"]) == len(HEADERS) + 1


def test_what_is_not_http_is_passed_on_as_it_is() -> None:
    start, _ = sent(kind="websocket.http")
    assert start["headers"] == []


def test_pages_may_load_from_this_site_only_and_stand_in_no_frame() -> None:
    rules = dict(rule.split(" ", 1) for rule in HEADERS["Content-Security-Policy"].split("; "))
    assert set(rules.values()) == {"'none'", "'self'"}
    assert (rules["default-src"], rules["frame-ancestors"], rules["base-uri"]) == ("'none'", "'none'", "'none'")
    assert HEADERS["X-Frame-Options"] == "DENY"
