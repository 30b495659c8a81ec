"""Serves the documentation site at `/docs`, which setup/docs.sh builds in `web/documentation`."""

from pathlib import Path

from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send

SITE = Path(__file__).parents[1] / "documentation"
PATH = "/docs"
NOT_BUILT = (
    "The documentation is not built yet. In a checkout, ./vitac serve builds it while it runs (a minute or two, once) "
    "and says if something is missing; ./vitac demo shows it from then on. Its source is the folder docs."
)
POLICY_FILE = "content-security-policy.txt"


class Documentation(StaticFiles):
    """The built site with its own Content-Security-Policy, which allows its inline scripts by their hashes."""

    def __init__(self) -> None:
        super().__init__(directory=SITE, html=True, check_dir=False)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with a page or file of the site.

        Raises:
            HTTPException: 404 for what the site does not have, 503 as long as it is not built.
        """
        if not _policy():
            raise HTTPException(503, NOT_BUILT)
        await super().__call__(scope, receive, send)

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Answer with a page or file, and the site's policy."""
        answer = await super().get_response(path, scope)
        answer.headers["Content-Security-Policy"] = _policy()
        answer.headers["Cache-Control"] = "no-cache"
        return answer


def _policy() -> str:
    """Read the policy of the site that is there now (one may be built while the service runs); empty without a site."""
    try:
        return (SITE / POLICY_FILE).read_text().strip()
    except FileNotFoundError:
        return ""
