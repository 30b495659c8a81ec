"""Serves the documentation site at `/docs`, which setup/docs.sh builds in `web/documentation`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from starlette.exceptions import HTTPException
from starlette.staticfiles import StaticFiles

if TYPE_CHECKING:
    from starlette.responses import Response
    from starlette.types import Receive, Scope, Send

SITE = Path(__file__).parents[1] / "documentation"
PATH = "/docs"
NOT_BUILT = (
    "The documentation was not built when this service was started. In a checkout, ./vitac serve builds it (about a "
    "minute, once) and says what is missing; ./vitac demo shows it from then on. Its source is the folder docs."
)
POLICY_FILE = "content-security-policy.txt"


class Documentation(StaticFiles):
    """The built site with its own Content-Security-Policy, which allows its inline scripts by their hashes."""

    def __init__(self) -> None:
        super().__init__(directory=SITE, html=True, check_dir=False)
        policy = SITE / POLICY_FILE
        self.policy = policy.read_text().strip() if policy.is_file() else ""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a page or file of the site.

        Raises:
            HTTPException: 404 for what the site does not have, 503 where it was not built.
        """
        if not self.policy:
            raise HTTPException(503, NOT_BUILT)
        await super().__call__(scope, receive, send)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with a page or file, and the site's policy."""
        answer = await super().get_response(path, scope)
        answer.headers["Content-Security-Policy"] = self.policy
        answer.headers["Cache-Control"] = "no-cache"
        return answer
