"""A browser without a window: sends requests to an application in this process and keeps its cookies."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
from starlette.types import ASGIApp

HEADERS = {"accept": "text/html,application/xhtml+xml", "sec-fetch-site": "same-origin"}


class AsgiBrowser:
    """Follows no redirect, so that tests see it; an application that crashes answers with what it answers."""

    def __init__(
        self, app: ASGIApp, *, base_url: str = "http://testserver", headers: dict[str, str] | None = None
    ) -> None:
        self.cookies = httpx.Cookies()
        self._app = app
        self._base_url = base_url
        self._headers = HEADERS if headers is None else headers

    def get(self, path: str, **arguments: Any) -> httpx.Response:
        """Asks for a page."""
        return self._request("GET", path, **arguments)

    def head(self, path: str) -> httpx.Response:
        """Asks for the headers of a page."""
        return self._request("HEAD", path)

    def post(self, path: str, **arguments: Any) -> httpx.Response:
        """Sends a form (`data`) or something else (`json`)."""
        return self._request("POST", path, **arguments)

    def _request(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        headers = self._headers | arguments.pop("headers", {})
        with ThreadPoolExecutor(1) as own_thread:  # the caller's may have a loop, as that of playwright
            return own_thread.submit(asyncio.run, self._send(method, path, headers=headers, **arguments)).result()

    async def _send(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        transport = httpx.ASGITransport(self._app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url=self._base_url, cookies=self.cookies) as client:
            answer = await client.request(method, path, **arguments)
            self.cookies = client.cookies
        return answer
