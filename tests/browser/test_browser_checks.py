"""What the check for barriers finds: contrast is measured at a few places of each look, and no look is left out."""

import pytest
from browser_checks import PLACES_PER_LOOK, violations
from playwright.sync_api import Browser

PAGE = """<!doctype html><html lang="en"><head><title>Contrast</title><style>
    body {{ background: white; color: black }} .pale {{ color: #bbb }} .dark {{ background: #222 }}
    .faded {{ opacity: 0.3 }} tr:nth-child(7) {{ background: #333 }}
</style></head><body><main><h1>Many of one look</h1>{readable}{content}</main></body></html>"""
READABLE = "".join(f"<p>readable line {number}</p>" for number in range(PLACES_PER_LOOK * 4))


HARD_TO_READ = {
    "its own colour": "<p class='pale'>its own colour</p>",
    "a colour by its style": "<p style='color: #bbb'>a colour by its style</p>",
    "what it stands in": "<section class='dark'><p>what it stands in</p></section>",
    "what fades it": "<section class='faded'><p>what fades it</p></section>",
    "row 7": "<table>" + "".join(f"<tr><td>row {number}</td></tr>" for number in range(1, 20)) + "</table>",
    "midst": "<p>in the <em class='pale'>midst</em> of a line</p>",
    "in a field": "<label>Name <input class='pale' value='in a field'></label>",
    "a button": "<button>one</button>" * 9 + "<button class='pale'>a button</button>",
    "wordless: <svg": "<svg width='9' height='9'></svg>",
    "wordless: <figure": "<figure class='plot'><figcaption>A plot</figcaption></figure>",
}


@pytest.mark.parametrize("hard", [{}, HARD_TO_READ], ids=["all is readable", "some is not"])
def test_text_that_is_hard_to_read_is_found_among_much_that_is_not(browser: Browser, hard: dict[str, str]) -> None:
    page = browser.new_page()
    page.set_content(PAGE.format(readable=READABLE, content="".join(hard.values())))
    reports = violations(page)
    page.close()
    assert all(report.startswith(("color-contrast: ", "wordless: ")) for report in reports)
    assert [sum(text in report for report in reports) for text in hard] == [1] * len(hard)
    assert len(reports) == len(hard)


def test_a_look_is_reported_by_its_first_places_and_other_barriers_wherever_they_are(browser: Browser) -> None:
    page = browser.new_page()
    many = "".join(f"<p class='pale'>pale {number}</p><img src='data:,'>" for number in range(PLACES_PER_LOOK * 2))
    page.set_content(PAGE.format(readable=READABLE, content=many))
    rules = [report.partition(":")[0] for report in violations(page)]
    page.close()
    assert rules.count("color-contrast") == PLACES_PER_LOOK
    assert rules.count("image-alt") == PLACES_PER_LOOK * 2
