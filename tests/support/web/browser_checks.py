"""What every page is checked for in a browser: sizes, accessibility, complaints of the browser."""

from typing import Any

from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import ConsoleMessage, Page

PHONE = {"width": 375, "height": 740}
DESK = {"width": 1280, "height": 800}
ZOOMED = {"width": 720, "height": 450}  # a window of 1440 px at 200 %
CHECKED = {
    "runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"],
    "resultTypes": ["violations"],  # every rule is run; the parts that pass, thousands on a page, are not written out
}

PLACES_PER_LOOK = 5
MEASURE_EACH_LOOK = """places => {
    const PAINT = [
        "color", "backgroundColor", "backgroundImage", "opacity", "fontSize", "fontWeight", "textShadow", "display",
        "visibility", "position", "zIndex", "overflow", "clip", "clipPath", "filter", "mixBlendMode", "transform",
    ];
    const looks = new Map(), numbers = new Map([[null, 0]]), marked = new Map();
    const lookOf = element => {
        if (!numbers.has(element)) {
            const style = getComputedStyle(element);
            const look = [lookOf(element.parentElement), element.localName, ...PAINT.map(name => style[name])].join();
            if (!looks.has(look)) looks.set(look, looks.size + 1);
            numbers.set(element, looks.get(look));
        }
        return numbers.get(element);
    };
    const hasText = element => [...element.childNodes].some(node => node.nodeType === 3 && node.data.trim().length > 1);
    for (const element of document.querySelectorAll("body, body *")) {
        element.removeAttribute("data-measured");  // in another colour scheme or size, before
        const isControl = element.matches("button, input, select, textarea");
        if (!isControl && !hasText(element)) continue;
        const look = lookOf(element), before = marked.get(look) ?? 0;
        if (isControl || before < places) element.setAttribute("data-measured", "");
        marked.set(look, before + 1);
    }
    axe.configure({ rules: [{ id: "color-contrast", selector: "[data-measured]" }] });
}"""
"""Contrast takes most of the time, on a long reference page all but a tenth of it, and depends on how text is painted.

So it is measured where text of one look stands first: its own colours and font, and those of all that it stands in.
"""

WORDLESS = """() => {
    const all = [...document.querySelectorAll("svg, canvas, img")];
    const pictures = all.filter((one) => !one.closest("[aria-hidden=true]"));
    const named = (one) => (one.getAttribute("aria-label") ?? one.getAttribute("alt") ?? "").trim();
    const plots = [...document.querySelectorAll("figure.plot")];
    return [...pictures.filter((one) => !named(one)), ...plots.filter((one) => !one.querySelector("tbody tr"))]
        .map((one) => one.outerHTML.slice(0, 120));
}"""


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
    """Rules of accessibility that a page breaks, each with the part of the page that does.

    Ours: a picture has words or repeats what stands beside it, and a plot has a table.
    """
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE_SCRIPT)
    page.evaluate(MEASURE_EACH_LOOK, PLACES_PER_LOOK)
    found: list[dict[str, Any]] = page.evaluate("options => axe.run(options).then(found => found.violations)", CHECKED)
    wordless = [f"wordless: {part}" for part in page.evaluate(WORDLESS)]
    broken = [
        f"{rule['id']}: {node['html'][:200]} {node['failureSummary']}" for rule in found for node in rule["nodes"]
    ]
    return broken + wordless
