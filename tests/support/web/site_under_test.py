"""The pages as a browser test meets them: where they are, what they show, and how to sign in."""

from dataclasses import dataclass

from page_fixtures import TASK
from page_service import FixedData
from playwright.sync_api import Page


@dataclass(frozen=True, kw_only=True)
class SiteUnderTest:
    """Pages with fixed content at an address."""

    address: str
    data: FixedData

    def path_of(self, name: str) -> str:
        """Path of the submission of that name."""
        return next(f"/submissions/{submission.id}" for submission in self.data.found if submission.name == name)

    def paths(self) -> list[str]:
        """One of each kind of page."""
        submissions = [self.path_of(submission.name) for submission in self.data.found]
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
            f"{self.path_of('both')}/output",
            f"{self.path_of('both')}/compare",
            f"{self.path_of('both')}/compare?with={self.path_of('done').rpartition('/')[2]}",
            "/compare",
        ]

    def sign_in(self, page: Page, name: str = "Gelbots") -> None:
        """Signs in by the form."""
        page.goto(f"{self.address}/sign-in")
        page.get_by_label("API token").fill(f"token-of-{name}")
        page.get_by_role("button", name="Sign in").click()
        page.wait_for_url(f"{self.address}/submissions")

    def enter(self, page: Page, name: str = "Gelbots") -> None:
        """Gives the browser a session from the form's address, without drawing the pages that a test is not about."""
        answer = page.request.post(f"{self.address}/sign-in", form={"token": f"token-of-{name}"}, max_redirects=0)
        assert answer.status == 303, f"expected to be signed in, got status {answer.status}"

    def open(self, page: Page, path: str) -> None:
        """Opens a page."""
        page.goto(f"{self.address}{path}")
