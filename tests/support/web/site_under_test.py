"""The pages as a browser test meets them: where they are, what they show, and how to sign in."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from playwright.sync_api import Page
from seeded_site import GELBOTS, SeededSite, seeded_site
from service_client import serving
from service_factories import TASK
from vitac.web.front import Recent


@dataclass(frozen=True, kw_only=True)
class SiteUnderTest:
    """A service with content at an address."""

    address: str
    seeded: SeededSite

    def path_of(self, name: str) -> str:
        """Path of the submission of that name."""
        return self.seeded.path_of(name)

    def paths(self) -> list[str]:
        """One of each kind of page."""
        submissions = [self.path_of(name) for name in (*self.seeded.seed.submissions, *self.seeded.added)]
        done = self.seeded.id_of("done")
        return [
            "/",
            "/tracks/track_1",
            f"/tracks/track_1?task={TASK}",
            "/tracks/track_1/logs",
            "/tracks/track_1/rules",
            "/sandbox",
            "/receipts",
            "/docs/",
            "/docs/deployment",
            "/docs/reference/environments",
            "/docs/search?q=Wilson+interval",
            "/competition",
            "/competition/archive",
            "/competitions/cup/archive",
            "/register",
            "/sign-in",
            "/submissions",
            "/submissions/upload",
            "/nothing-here",
            *submissions,
            f"{self.path_of('broke')}/output",
            f"{self.path_of('both')}/compare",
            f"{self.path_of('both')}/compare?with={done}",
            "/compare",
        ]

    def sign_in(self, page: Page, name: str = GELBOTS) -> None:
        """Signs in by the form."""
        page.goto(f"{self.address}/sign-in")
        page.get_by_label("API token").fill(self.seeded.token_of(name))
        page.get_by_role("button", name="Sign in").click()
        page.wait_for_url(f"{self.address}/submissions")

    def enter(self, page: Page, name: str = GELBOTS) -> None:
        """Gives the browser a session from the form's address, without drawing the pages that a test is not about."""
        token = self.seeded.token_of(name)
        answer = page.request.post(f"{self.address}/sign-in", form={"token": token}, max_redirects=0)
        assert answer.status == 303, f"expected to be signed in, got status {answer.status}"

    def open(self, page: Page, path: str) -> None:
        """Opens a page."""
        page.goto(f"{self.address}{path}")


@contextmanager
def served_site() -> Iterator[SiteUnderTest]:
    """A service with content that a browser can reach, and which reads anew what it else caches for some seconds."""
    with seeded_site() as seeded:
        pages = seeded.app.state.site
        seeded.app.state.site = replace(pages, front=Recent(kept_s=0.0), competitions=Recent(kept_s=0.0))
        with serving(seeded.app) as (host, port):
            yield SiteUnderTest(address=f"http://{host}:{port}", seeded=seeded)
