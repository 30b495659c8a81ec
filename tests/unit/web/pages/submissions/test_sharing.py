import re
from uuid import uuid4

import pytest
from seeded_site import BEARS, GELBOTS, ORGANIZERS, SeededSite, form_token, words
from service_factories import TASK
from sqlalchemy import update
from vitac.server.accounts import teams
from vitac.server.database.models import NearCopy, Submission, Team
from vitac.server.evaluations.copies import mark_copy
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.principals import CONSOLE


@pytest.fixture
def page(site: SeededSite) -> str:
    """The page of a submission that everybody may see."""
    with site.database.transaction() as session:
        set_public(session, site.seed.people[GELBOTS], site.id_of("both"), public=True)
    return site.path_of("both")


def test_everybody_sees_the_result_and_nothing_of_the_team(site: SeededSite, page: str) -> None:
    for browser in (site.visitor(), site.visitor(BEARS)):
        html = browser.get(page).text
        for shown in ("Outcome by start offset", "episodes.csv", "Cite this result", "@misc{vitac_"):
            assert shown in html
        assert "73.3 %" in words(html)
        for hidden in ("Make it private", "Submissions so far", "/output", "/api/v1/submissions/", "Cancel"):
            assert hidden not in html, hidden
        assert '<a href="/tracks/track_1">' in html
        assert browser.get(f"{page}/episodes.csv").text.startswith("task,episode,shape")
        assert len(browser.get(f"{page}/episodes.json").json()) == 430


def test_what_is_private_and_what_is_not_there_look_alike(site: SeededSite, page: str) -> None:
    private = site.path_of("done")
    for path in (private, f"/submissions/{uuid4()}"):
        for part in ("", "/preview.png", "/episodes.csv", "/episodes.json", f"/episodes/{TASK}/5"):
            answer = site.visitor().get(path + part)
            assert answer.status_code == 303
            assert answer.headers["location"].startswith("/sign-in?next=")
    for part in ("/output", "/compare", "/events"):
        assert site.visitor().get(page + part).status_code in {204, 303}, part
    for part in ("", "/episodes.csv", f"/episodes/{TASK}/5"):
        assert site.visitor(BEARS).get(private + part).status_code == 404


def test_a_link_is_shown_with_a_picture_once_it_is_public(site: SeededSite, page: str) -> None:
    browser = site.visitor()
    named = dict(re.findall(r'<meta property="og:(\w+)" content="([^"]*)">', browser.get(page).text))
    assert named["url"] == f"http://testserver{page}"
    assert named["image"] == f"http://testserver{page}/preview.png"
    assert named["title"] == "both · Gelbots"
    picture = browser.get(f"{page}/preview.png")
    assert picture.headers["content-type"] == "image/png"
    assert picture.headers["cache-control"] == "public, max-age=300"
    assert picture.headers["cross-origin-resource-policy"] == "cross-origin"
    assert picture.content.startswith(b"\x89PNG")
    again = browser.get(f"{page}/preview.png", headers={"if-none-match": picture.headers["etag"]})
    assert again.status_code == 304
    for changed in (update(Submission).values(name="better"), update(Team).values(name=Team.name + "s")):
        before = browser.get(f"{page}/preview.png").content
        with site.database.transaction() as session:
            session.execute(changed)
        assert browser.get(f"{page}/preview.png").content != before, "it follows the names"
    assert "og:image" not in site.visitor(GELBOTS).get(site.path_of("done")).text


def test_a_team_makes_its_submission_public_and_private_by_a_button(site: SeededSite) -> None:
    browser, page = site.visitor(GELBOTS), site.path_of("done")
    assert "Make it public" in browser.get(page).text
    assert browser.post(f"{page}/public", data={"public": "yes"}).status_code == 403
    for public, button, others in (("yes", "Make it private", 200), ("no", "Make it public", 303)):
        answer = browser.post(f"{page}/public", data={"public": public, "form_token": form_token(browser)})
        assert (answer.status_code, answer.headers["location"]) == (303, f"{page}#sharing")
        assert button in browser.get(page).text
        assert site.visitor().get(page).status_code == others
    running = site.path_of("runs")
    browser.post(f"{running}/public", data={"public": "yes", "form_token": form_token(browser)})
    assert "as soon as the evaluation is complete" in browser.get(running).text
    assert site.visitor().post(f"{page}/public", data={"public": "yes"}).status_code == 303


def test_boards_link_public_results_for_everybody(site: SeededSite, page: str) -> None:
    html = site.visitor().get("/tracks/track_1").text
    assert f'href="{page}"' in html
    assert f'href="{site.path_of("sharp")}"' not in html


def test_a_description_is_text_whose_links_say_where_they_lead_and_organizers_remove_it(
    site: SeededSite, page: str
) -> None:
    team, organizer = site.visitor(GELBOTS), site.visitor(ORGANIZERS)
    code = "https://github.com/bears/policy?a=1&b=2"
    written = {"text": "<script>alert(1)</script>\nTwo layers.", "code": code, "base": ""}
    assert team.post(f"{page}/description", data=written).status_code == 403
    answer = team.post(f"{page}/description", data=written | {"form_token": form_token(team)})
    assert (answer.status_code, answer.headers["location"]) == (303, f"{page}#about")
    html = site.visitor().get(page).text
    link = '<a href="https://github.com/bears/policy?a=1&amp;b=2" rel="nofollow noopener">'
    assert "&lt;script&gt;alert(1)&lt;/script&gt;\nTwo layers." in html
    assert f"{link}https://github.com/bears/policy?a=1&amp;b=2</a>" in html
    assert "Change the description" not in html
    assert f"{link}code<span" in site.visitor().get("/tracks/track_1").text
    own = team.get(page).text
    assert ("Change the description" in own, "Remove the description" in own) == (True, False)
    removal = f"{page}/description/removal"
    assert team.post(removal, data={"form_token": form_token(team), "reason": "No."}).status_code == 403
    assert "Remove the description" in organizer.get(page).text
    organizer.post(removal, data={"form_token": form_token(organizer), "reason": "An advertisement."})
    assert "Two layers." not in site.visitor().get(page).text
    own = team.get(page).text
    assert ("An advertisement." in own, "Change the description" in own) == (True, False)
    assert "Restore the description" in organizer.get(page).text
    organizer.post(removal, data={"form_token": form_token(organizer)})
    assert "Two layers." in site.visitor().get(page).text


def test_a_team_is_told_when_others_do_not_see_its_public_page_now(site: SeededSite, page: str) -> None:
    assert "Everybody may see this page." in words(site.visitor(GELBOTS).get(page).text)
    with site.database.transaction() as session:
        team = session.get_one(Team, site.seed.people[GELBOTS].team_id)
        teams.disqualify(session, CONSOLE, team, "cheated")
    html = site.visitor(GELBOTS).get(page).text
    assert "Everybody may see this page" not in words(html)
    assert "Others do not see this page now" in words(html)
    assert "Make it private" in html


def test_organizers_clear_a_copy_with_a_reason_that_its_team_reads(site: SeededSite) -> None:
    """A copy that acts as an earlier submission of another team is not ranked until then."""
    with site.evaluation("sharp") as (session, evaluation):
        session.add(
            NearCopy(
                evaluation_id=evaluation.id,
                earlier_submission_id=site.id_of("both"),
                task=TASK,
                near=268,
                episodes=270,
                difference=0.001,
            )
        )
        session.flush()
        mark_copy(session, evaluation)
    page = site.path_of("sharp")
    team, organizer = site.visitor(BEARS), site.visitor(ORGANIZERS)
    assert "earlier submission of Gelbots" in words(team.get(page).text)
    assert f'action="{page}/clearance"' not in team.get(page).text
    assert "is not ranked until an organizer has cleared it" in words(organizer.get(page).text)
    token = {"form_token": form_token(organizer)}
    assert organizer.post(f"{page}/clearance", data=token | {"reason": "made apart"}).status_code == 303
    for browser in (team, organizer):
        assert "An organizer has cleared it: made apart" in words(browser.get(page).text)
    assert organizer.post(f"{page}/clearance", data=token).status_code == 303
    assert "is not ranked until an organizer has cleared it" in words(organizer.get(page).text)
