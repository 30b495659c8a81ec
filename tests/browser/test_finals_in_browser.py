"""Pages of stages that are judged or played on stations: barriers, and what fits a desk and a phone."""

from pathlib import Path

import pytest
from browser_checks import DESK, PHONE, violations
from playwright.sync_api import Page, expect
from site_under_test import SiteUnderTest
from sqlalchemy import select
from station_final import ADDRESS, PLAYED, hold_final, play
from vitac.server.competitions.definition import read_competition
from vitac.server.database.models import Submission
from waiting import resize

from competitions import open_now


def look(page: Page) -> None:
    """Looks at a page at both sizes."""
    expect(page.get_by_role("heading", level=1)).to_be_visible()
    for scheme, size in (("light", DESK), ("dark", PHONE)):
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        resize(page, size)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], f"{page.url} scrolls sideways"
        assert violations(page) == [], f"{page.url}, {scheme}"


def test_pages_of_a_final_have_no_barriers(
    page: Page, site: SiteUnderTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    teams = hold_final(site.seeded, tmp_path, monkeypatch)
    play(site.seeded, twin="a twin of class B, no hardware")
    with site.seeded.database.transaction() as session:
        own = session.scalars(select(Submission.id).where(Submission.team_id == teams["Ants"].team_id)).one()
    cookies = site.seeded.team_visitor("Ants").cookies
    page.context.add_cookies([{"name": name, "value": value, "url": site.address} for name, value in cookies.items()])
    for path in (ADDRESS, f"/submissions/{own}/trials/{PLAYED}/1"):
        page.goto(site.address + path)
        look(page)


def test_the_page_of_briefs_has_no_barriers(page: Page, site: SiteUnderTest, repository: Path) -> None:
    content = read_competition(repository / "competitions" / "vitac-2026.yaml").model_dump(mode="json")
    site.seeded.hold(open_now(content, 0, "real_robot"))
    site.enter(page)
    page.goto(f"{site.address}/competition")
    page.get_by_role("link", name="a brief of 2 to 4 pages as PDF").click()
    expect(page.get_by_role("button", name="Hand in")).to_be_visible()
    look(page)
