"""Briefs by page: handed in by a team, read and decided about by organizers."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from httpx import Response
from seeded_site import BEARS, GELBOTS, ORGANIZERS, SeededSite, form_token, words
from vitac.server.competitions.definition import read_competition
from vitac.server.submissions.briefs import BRIEF_BYTES

from competitions import open_now

EDITION_2026 = Path(__file__).parents[5] / "competitions" / "vitac-2026.yaml"
PLACE = {"competition": "vitac-2026", "track": "real_robot", "stage": "stage1"}
ADDRESS = "/competitions/vitac-2026/tracks/real_robot/stages/stage1/briefs"


def pdf(pages: int) -> bytes:
    return b"%PDF-1.4\n" + b"".join(b"%d 0 obj << /Type /Page >> endobj\n" % number for number in range(1, pages + 1))


@pytest.fixture
def edition(site: SeededSite) -> dict[str, Any]:
    """The competition of 2026 with its first stage open."""
    content = open_now(read_competition(EDITION_2026).model_dump(mode="json"), 0, "real_robot")
    site.hold(content)
    return content


def send(browser: AsgiBrowser, content: bytes, **place: str) -> Response:
    fields = {"form_token": form_token(browser)} | PLACE | place
    return browser.post("/briefs/own", data=fields, files={"file": ("brief.pdf", content)})


def close(site: SeededSite, edition: dict[str, Any]) -> None:
    edition["tracks"]["real_robot"]["stages"][0]["closes"] = (datetime.now(UTC) - timedelta(hours=1)).isoformat()
    site.hold(edition)


def test_a_team_hands_in_its_brief_which_no_team_reads(site: SeededSite, edition: dict[str, Any]) -> None:
    team, other = site.visitor(GELBOTS), site.visitor(BEARS)
    assert f'href="{ADDRESS}"' in site.visitor().get("/competition").text
    assert "Your team has handed in none." in team.get(ADDRESS).text
    assert send(team, pdf(2)).headers["location"] == ADDRESS
    assert send(team, pdf(3)).status_code == 303
    assert "3 pages" in words(team.get(ADDRESS).text)
    organizer = site.visitor(ORGANIZERS)
    document = organizer.get(ADDRESS).text.partition(f'href="{ADDRESS}/')[2].partition('"')[0]
    answer = organizer.get(f"{ADDRESS}/{document}")
    assert (answer.content, answer.headers["content-type"]) == (pdf(3), "application/pdf")
    assert "attachment" in answer.headers["content-disposition"]
    assert other.get(f"{ADDRESS}/{document}").status_code == team.get(f"{ADDRESS}/{document}").status_code == 403
    assert "handed in none" in other.get(ADDRESS).text
    assert site.visitor().get(ADDRESS).status_code == 303


@pytest.mark.parametrize(
    ("content", "place", "status", "sentence"),
    [
        (pdf(1), {}, 422, "Expected a brief of 2 to 4 pages as PDF, got one of 1."),
        (bytes(BRIEF_BYTES + 1), {}, 413, "at most 10 MiB"),
        (pdf(2), {"stage": "stage2"}, 404, "takes no briefs"),
    ],
)
def test_a_brief_that_is_refused_says_why(
    site: SeededSite, edition: dict[str, Any], content: bytes, place: dict[str, str], status: int, sentence: str
) -> None:
    answer = send(site.visitor(GELBOTS), content, **place)
    assert answer.status_code == status
    assert sentence in words(answer.text)


def test_organizers_decide_after_the_close_and_hand_in_nothing(site: SeededSite, edition: dict[str, Any]) -> None:
    team, organizer = site.visitor(GELBOTS), site.visitor(ORGANIZERS)
    send(team, pdf(2))
    assert "decides once the stage has closed" in organizer.get(ADDRESS).text
    assert send(organizer, pdf(2)).status_code == 403
    close(site, edition)
    assert 'type="file"' not in team.get(ADDRESS).text
    identity = organizer.get(ADDRESS).text.partition('id="team-')[2].partition('"')[0]
    decision = {"form_token": form_token(organizer), "reason": "<b>clear</b>", "decision": "accept"}
    assert organizer.post(f"{ADDRESS}/{identity}/decision", data=decision).headers["location"] == ADDRESS
    assert "&lt;b&gt;clear&lt;/b&gt;" in team.get(ADDRESS).text
    assert "accepted on" in words(team.get(ADDRESS).text)
    forged = decision | {"form_token": form_token(team), "decision": "decline"}
    assert team.post(f"{ADDRESS}/{identity}/decision", data=forged).status_code == 403
    assert "accepted on" in words(organizer.get(ADDRESS).text)
