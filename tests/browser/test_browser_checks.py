"""What the check for barriers finds: contrast is measured at a few places of each look, and no look is left out."""

import pytest
from browser_checks import PLACES_PER_LOOK, violations
from playwright.sync_api import Browser

PAGE = """<!doctype html><html lang="en"><head><title>Contrast</title><style>
    body {{ background: white; color: black }} .pale {{ color: #bbb }} .dark {{ background: #222 }}
    .faded {{ opacity: 0.3 }} tr:nth-child(7) {{ background: #333 }}
</style></head><body><main><h1>Many of one look</h1>{readable}{content}</main></body></html>"""
READABLE = "".join(f"<p>readable line {number}</p>" for number in range(PLACES_PER_LOOK * 4))


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ("", []),
        ("<p class='pale'>its own colour</p>", ["its own colour"]),
        ("<p style='color: #bbb'>a colour by its style</p>", ["a colour by its style"]),
        ("<section class='dark'><p>what it stands in</p></section>", ["what it stands in"]),
        ("<section class='faded'><p>what fades it</p></section>", ["what fades it"]),
        (
            "<table>" + "".join(f"<tr><td>row {number}</td></tr>" for number in range(1, 20)) + "</table>",
            ["row 7"],
        ),
        ("<p>in the <em class='pale'>midst</em> of a line</p>", ["midst"]),
        ("<label>Name <input class='pale' value='in a field'></label>", ["in a field"]),
        ("<svg width='9' height='9'></svg>", ["wordless: <svg"]),
        ("<figure class='plot'><figcaption>A plot</figcaption></figure>", ["wordless: <figure"]),
        ("<button>one</button>" * 9 + "<button class='pale'>a button</button>", ["a button"]),
    ],
)
def test_text_that_is_hard_to_read_is_found_among_much_that_is_not(
    browser: Browser, content: str, found: list[str]
) -> None:
    page = browser.new_page()
    page.set_content(PAGE.format(readable=READABLE, content=content))
    reports = violations(page)
    page.close()
    assert len(reports) == len(found)
    for report, text in zip(reports, found, strict=True):
        assert report.startswith(("color-contrast: ", "wordless: "))
        assert text in report


def test_a_look_is_reported_by_its_first_places_and_other_barriers_wherever_they_are(browser: Browser) -> None:
    page = browser.new_page()
    many = "".join(f"<p class='pale'>pale {number}</p><img src='data:,'>" for number in range(PLACES_PER_LOOK * 2))
    page.set_content(PAGE.format(readable=READABLE, content=many))
    rules = [report.partition(":")[0] for report in violations(page)]
    page.close()
    assert rules.count("color-contrast") == PLACES_PER_LOOK
    assert rules.count("image-alt") == PLACES_PER_LOOK * 2
