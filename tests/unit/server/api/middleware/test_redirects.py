import asyncio

import httpx
from fastapi import FastAPI
from vitac.server.api.middleware.requests import RelativeRedirects


def test_a_redirect_does_not_follow_the_host_header() -> None:
    app = FastAPI()
    app.add_middleware(RelativeRedirects)
    app.get("/team")(lambda: None)

    async def ask() -> httpx.Response:
        inside = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=inside, base_url="http://elsewhere.example") as client:
            return await client.get("/team/?a=b")

    answer = asyncio.run(ask())
    assert (answer.status_code, answer.headers["location"]) == (307, "/team?a=b")
