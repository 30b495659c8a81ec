"""What every page is checked for in a browser: sizes, accessibility, complaints of the browser."""

from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import ConsoleMessage, Page

PHONE = {"width": 375, "height": 740}
DESK = {"width": 1280, "height": 800}
ZOOMED = {"width": 720, "height": 450}  # a window of 1440 px at 200 %
CHECKED = {
    "runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"],
    "resultTypes": ["violations"],  # every rule is run; the parts that pass, thousands on a page, are not written out
}


class Complaints:
    """What the browser complains about while a page is open, but for answers that a test asked for."""

    def __init__(self, page: Page) -> None:
        self.heard: list[str] = []
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.heard.append(str(error)))

    def _on_console(self, message: ConsoleMessage) -> None:
        expected = "status of 404" in message.text
        if message.type in {"error", "warning"} and not expected:
            self.heard.append(message.text)


def violations(page: Page) -> list[str]:
    """Rules of accessibility that a page breaks, each with the part of the page that does."""
    found: dict[str, Any] = Axe().run(page, options=CHECKED).response
    return [
        f"{rule['id']}: {node['html'][:200]} {node['failureSummary']}"
        for rule in found["violations"]
        for node in rule["nodes"]
    ]
