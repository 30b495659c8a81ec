"""What the Tab key meets on a page, for tests of the pages."""

from typing import Any

from playwright.sync_api import Page

STOPS = """() => {
    const isStop = (one) => one.tabIndex >= 0 && !one.disabled && one.checkVisibility({ visibilityProperty: true });
    const kinds = "a[href], button, input:not([type=hidden]), select, textarea, summary, [tabindex]";
    const stops = [...document.querySelectorAll(kinds)].filter(isStop);
    const name = (one) => one.outerHTML.slice(0, 120);
    const met = new Set(), hidden = [];
    const isCovered = (one) => {
        const { left, right, top: above, bottom } = one.getClientRects()[0];
        const seen = (Math.max(0, above) + Math.min(innerHeight, bottom)) / 2;
        const top = document.elementFromPoint((left + right) / 2, seen);
        return !top || !(one.contains(top) || top.contains(one));
    };
    document.addEventListener("focusin", ({ target }) => {
        met.add(target);
        const place = target.getBoundingClientRect(), style = getComputedStyle(target);
        const isRinged = style.outlineStyle === "solid" && parseFloat(style.outlineWidth) >= 2;
        const isOutside = place.bottom <= 0 || place.top >= innerHeight;
        if (!isRinged || isOutside || isCovered(target)) hidden.push(name(target));
    });
    window.stops = { left: () => stops.filter((one) => !met.has(one)).map(name), hidden };
    return stops.length;
}"""


def press_tab_through(page: Page) -> Any:
    """Presses Tab once for each stop of a page and returns those not reached, and those whose focus nobody sees."""
    stops = page.evaluate(STOPS)
    assert stops > 3
    for _ in range(stops):
        page.keyboard.press("Tab")
    return page.evaluate("({ left: stops.left(), hidden: stops.hidden })")
