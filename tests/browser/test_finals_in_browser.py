"""Pages of stages that are judged or played on stations: barriers, and what fits a desk and a phone."""

from datetime import timedelta
from pathlib import Path

import pytest
from browser_checks import DESK, PHONE, violations
from playwright.sync_api import Page, expect
from site_under_test import SiteUnderTest
from sqlalchemy import select
from station_final import ADDRESS, PLAYED, hold_final, play, stage_of
from vitac.server.competitions.definition import read_competition
from vitac.server.database.clock import read_clock
from vitac.server.database.models import LivePicture, Submission
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


@pytest.mark.slow
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


def test_a_visitor_watches_a_station_and_reads_when_it_shows_nothing(
    page: Page, site: SiteUnderTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, repository: Path
) -> None:
    hold_final(site.seeded, tmp_path, monkeypatch)
    page.goto(site.address + ADDRESS)
    east, west = (page.get_by_role("figure").filter(has_text=f"Station {name}") for name in ("east", "west"))
    expect(east.get_by_text("No picture at present")).to_be_visible()
    with stage_of(site.seeded) as (session, stage):
        names = {"competition": stage.competition, "track": stage.track, "stage": stage.name}
        picture = (repository / "web" / "static" / "peg-insertion-left.webp").read_bytes()
        taken_at = read_clock(session) - timedelta(seconds=61)
        session.add(LivePicture(station="east", picture=picture, taken_at=taken_at, **names))
    expect(east.get_by_role("img")).to_be_visible()
    expect(east.get_by_text("No picture at present")).to_be_hidden()
    expect(west.get_by_text("No picture at present")).to_be_visible()
    expect(west.get_by_role("img")).to_be_hidden()
    look(page)


@pytest.mark.slow
def test_the_page_of_briefs_has_no_barriers(page: Page, site: SiteUnderTest, repository: Path) -> None:
    content = read_competition(repository / "competitions" / "vitac-2026.yaml").model_dump(mode="json")
    site.seeded.hold(open_now(content, 0, "real_robot"))
    site.enter(page)
    page.goto(f"{site.address}/competition")
    page.get_by_role("link", name="a brief of 2 to 4 pages as PDF").click()
    expect(page.get_by_role("button", name="Hand in")).to_be_visible()
    look(page)
