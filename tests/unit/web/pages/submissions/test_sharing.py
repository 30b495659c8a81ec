import re

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, MADE_UP_SCORES, TASK, a_leaderboard, an_entry, an_id
from page_service import FixedData, an_application
from played_episodes import a_shown_episode
from visits import BEARS, BOTH, COMPLETED, GELBOTS, RUNNING, form_token, sign_in
from vitac.server.leaderboards import descriptions
from vitac.server.submissions import disqualification
from vitac.server.views.evaluations import CopyView
from vitac.server.views.submissions import DescriptionView, EpisodeOutputView

PAGE = f"/submissions/{COMPLETED.id}"


@pytest.fixture
def public(data: FixedData) -> FixedData:
    """The same, with one submission that everybody may see."""
    data.found = [found.model_copy(update={"public": found.id == COMPLETED.id}) for found in data.found]
    data.printed = [EpisodeOutputView(task=TASK, episode=1, outcome="success", output="a secret")]
    return data


@pytest.mark.usefixtures("public")
def test_everybody_sees_the_result_and_nothing_of_the_team(browser: AsgiBrowser) -> None:
    for reader in ("nobody", "Bears"):
        if reader == "Bears":
            sign_in(browser, reader)
        html = browser.get(PAGE).text.replace("\N{NO-BREAK SPACE}", " ")
        for shown in ("86.7 %", "Outcome by start offset", "episodes.csv", "Cite this result", "@misc{vitac_"):
            assert shown in html
        for hidden in (
            "Make it private",
            "Submissions so far",
            "/output",
            "/api/v1/submissions/",
            "Cancel",
        ):
            assert hidden not in html, hidden
        assert f'<a href="/tracks/{COMPLETED.track}">' in html
        assert browser.get(f"{PAGE}/episodes.csv").text.startswith("task,episode,shape")
        assert len(browser.get(f"{PAGE}/episodes.json").json()) == 270


@pytest.mark.usefixtures("public")
def test_what_is_private_and_what_is_not_there_look_alike(browser: AsgiBrowser) -> None:
    for path in (f"/submissions/{BOTH.id}", f"/submissions/{an_id('nobody')}"):
        for part in ("", "/preview.png", "/episodes.csv", "/episodes.json", f"/episodes/{TASK}/5"):
            answer = browser.get(path + part)
            assert answer.status_code == 303
            assert answer.headers["location"].startswith("/sign-in?next=")
    for part in ("/output", "/compare", "/events"):
        assert browser.get(PAGE + part).status_code in {204, 303}, part
    sign_in(browser, "Bears")
    for part in ("", "/episodes.csv", f"/episodes/{TASK}/5"):
        assert browser.get(f"/submissions/{BOTH.id}{part}").status_code == 404


def test_a_link_is_shown_with_a_picture_once_it_is_public(public: FixedData) -> None:
    browser = AsgiBrowser(an_application(public))
    html = browser.get(PAGE).text
    named = dict(re.findall(r'<meta property="og:(\w+)" content="([^"]*)">', html))
    assert named["url"] == f"http://testserver{PAGE}"
    assert named["image"] == f"http://testserver{PAGE}/preview.png"
    assert named["title"] == "done · Gelbots"
    picture = browser.get(f"{PAGE}/preview.png")
    assert picture.headers["content-type"] == "image/png"
    assert picture.headers["cache-control"] == "public, max-age=300"
    assert picture.headers["cross-origin-resource-policy"] == "cross-origin"
    assert picture.content.startswith(b"\x89PNG")
    again = browser.get(f"{PAGE}/preview.png", headers={"if-none-match": picture.headers["etag"]})
    assert again.status_code == 304
    sign_in(browser, "Gelbots")
    assert "og:image" not in browser.get(f"/submissions/{BOTH.id}").text


def test_a_team_makes_its_submission_public_and_private_by_a_button(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    assert "Make it public" in browser.get(PAGE).text
    assert browser.post(f"{PAGE}/public", data={"public": "yes"}).status_code == 403
    for public, button in (("yes", "Make it private"), ("no", "Make it public")):
        answer = browser.post(f"{PAGE}/public", data={"public": public, "form_token": form_token(browser)})
        assert (answer.status_code, answer.headers["location"]) == (303, f"{PAGE}#sharing")
        assert button in browser.get(PAGE).text
        assert [found.public for found in data.found if found.id == COMPLETED.id] == [public == "yes"]
    browser.post(f"/submissions/{RUNNING.id}/public", data={"public": "yes", "form_token": form_token(browser)})
    assert "as soon as the evaluation is complete" in browser.get(f"/submissions/{RUNNING.id}").text
    assert AsgiBrowser(an_application(data)).post(f"{PAGE}/public", data={"public": "yes"}).status_code == 303


def test_a_visitor_watches_an_episode_and_asks_for_its_playback(public: FixedData, browser: AsgiBrowser) -> None:
    address = public.show(COMPLETED.id, a_shown_episode())
    assert "Make the playback" in browser.get(address).text
    asked = browser.post(f"{address}/playback", data={"beside": ""})
    assert (asked.status_code, asked.headers["location"]) == (303, address)
    assert len(public.asked) == 1
    hidden = public.show(BOTH.id, a_shown_episode())
    assert browser.post(f"{hidden}/playback", data={"beside": ""}).headers["location"].startswith("/sign-in")
    assert len(public.asked) == 1
    sign_in(browser, "Bears")
    assert browser.post(f"{address}/playback", data={"beside": ""}).status_code == 403, (
        "who is signed in has a token to send"
    )


def test_boards_link_public_results_for_everybody(public: FixedData, browser: AsgiBrowser) -> None:
    scores = (MADE_UP_SCORES[TASK], MADE_UP_SCORES[LOCK])
    ours = an_entry(1, "Gelbots", *scores).model_copy(update={"submission_id": COMPLETED.id})
    theirs = an_entry(2, "Bears", *scores)
    public.board = a_leaderboard(ours, theirs)
    html = browser.get("/tracks/track_1").text
    assert f'href="/submissions/{COMPLETED.id}"' in html
    assert f'href="/submissions/{theirs.submission_id}"' not in html
    assert {GELBOTS.team_name, BEARS.team_name} == {entry.team for entry in public.board.entries}


DESCRIPTION = DescriptionView(
    text="<script>alert(1)</script>\nTwo layers.", code="https://github.com/bears/policy?a=1&b=2", revision="1"
)


def describe(data: FixedData, description: DescriptionView) -> None:
    data.found = [
        found.model_copy(update={"description": description}) if found.id == COMPLETED.id else found
        for found in data.found
    ]


def test_a_description_is_shown_as_text_with_links_that_say_where_they_lead(
    public: FixedData, browser: AsgiBrowser
) -> None:
    describe(public, DESCRIPTION)
    link = '<a href="https://github.com/bears/policy?a=1&amp;b=2" rel="nofollow noopener">'
    html = browser.get(PAGE).text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;\nTwo layers." in html
    assert f"{link}https://github.com/bears/policy?a=1&amp;b=2</a>" in html
    assert "Change the description" not in html
    public.board = a_leaderboard(
        an_entry(1, "Gelbots", MADE_UP_SCORES[TASK], MADE_UP_SCORES[LOCK]).model_copy(
            update={"submission_id": COMPLETED.id}
        )
    )
    assert f"{link}code<span" in browser.get("/tracks/track_1").text
    sign_in(browser, "Gelbots")
    assert 'name="base" value="1"' in browser.get(PAGE).text
    assert "Remove the description" not in browser.get(PAGE).text


def test_an_organizer_removes_a_description_and_its_team_reads_why(public: FixedData, browser: AsgiBrowser) -> None:
    describe(public, DESCRIPTION)
    sign_in(browser, "organizers")
    assert "Remove the description" in browser.get(PAGE).text
    describe(public, DESCRIPTION.model_copy(update={"removed_for": "An advertisement."}))
    assert "Restore the description" in browser.get(PAGE).text
    sign_in(browser, "Gelbots")
    html = browser.get(PAGE).text
    assert "An advertisement." in html
    assert "Change the description" not in html


def test_forms_of_descriptions_lead_to_the_service(
    public: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[object] = []
    monkeypatch.setattr(descriptions, "describe", lambda _, by, *of, **given: done.append((by.team_name, given)))
    monkeypatch.setattr(descriptions, "find_description", lambda *_: DESCRIPTION)
    monkeypatch.setattr(descriptions, "remove", lambda _, by, of, reason: done.append(reason))
    monkeypatch.setattr(descriptions, "restore", lambda _, by, of: done.append("restored"))
    describe(public, DESCRIPTION)
    sign_in(browser, "Gelbots")
    token = form_token(browser)
    assert browser.post(f"{PAGE}/description", data={"text": "A", "base": "1"}).status_code == 403
    answer = browser.post(f"{PAGE}/description", data={"text": "A", "base": "1", "form_token": token})
    assert (answer.status_code, answer.headers["location"]) == (303, f"{PAGE}#about")
    browser.post(f"{PAGE}/description", data={"text": "B", "base": "", "form_token": token})
    assert browser.post(f"{PAGE}/description/removal", data={"form_token": token}).status_code == 403
    sign_in(browser, "organizers")
    for fields in ({"reason": "No."}, {}):
        browser.post(f"{PAGE}/description/removal", data={"form_token": form_token(browser)} | fields)
    written = {"text": "A", "base": "1", "code": "", "paper": "", "discussion": ""}
    first = {**written, "text": "B", "base": ""}
    assert done == [("Gelbots", written), ("Gelbots", first), "No.", "restored"]


def test_a_public_result_without_a_score_over_all_tasks_has_a_page(public: FixedData, browser: AsgiBrowser) -> None:
    unscored = COMPLETED.evaluation.model_copy(update={"played": None})
    public.found = [
        found.model_copy(update={"evaluation": unscored}) if found.id == COMPLETED.id else found
        for found in public.found
    ]
    answer = browser.get(PAGE)
    assert answer.status_code == 200
    assert "95 % interval" not in answer.text.split("<body")[0], "of the link"


def test_the_picture_of_a_link_follows_the_names(public: FixedData) -> None:
    browser = AsgiBrowser(an_application(public))
    pictures = [browser.get(f"{PAGE}/preview.png").content]
    for change in ({"name": "better"}, {"team": BEARS}):
        public.found = [
            found.model_copy(update=change) if found.id == COMPLETED.id else found for found in public.found
        ]
        pictures.append(browser.get(f"{PAGE}/preview.png").content)
    assert len(set(pictures)) == 3


def test_a_team_is_told_when_others_do_not_see_its_public_page_now(
    public: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign_in(browser, "Gelbots")
    assert "Everybody may see this page." in browser.get(PAGE).text

    def nothing(submissions: object) -> frozenset[object]:
        return frozenset()

    monkeypatch.setattr(public, "public_among", nothing)
    html = browser.get(PAGE).text
    assert "Everybody may see this page" not in html
    assert "Others do not see this page now" in html
    assert "Make it private" in html


def test_organizers_clear_a_copy_with_a_reason_that_its_team_reads(
    data: FixedData, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = CopyView(team="Bears", episodes=88, of=90, task=TASK, ranked=False)
    cleared = copy.model_copy(update={"ranked": True, "cleared_for": "made apart"})
    done: list[str | None] = []
    monkeypatch.setattr(disqualification, "clear", lambda _session, _by, _id, reason: done.append(reason))
    monkeypatch.setattr(disqualification, "withdraw", lambda _session, _by, _id: done.append(None))
    for reader, found, sentence in (
        ("Gelbots", copy, "are near those of an earlier submission of Bears"),
        ("organizers", copy, "is not ranked until an organizer has cleared it"),
        ("organizers", cleared, "An organizer has cleared it: made apart"),
    ):
        data.found = [each.model_copy(update={"copy_of": found}) for each in data.found]
        browser = AsgiBrowser(an_application(data))
        sign_in(browser, reader)
        html = browser.get(PAGE).text.replace("\N{NO-BREAK SPACE}", " ")
        assert sentence in html
        assert (f'action="{PAGE}/clearance"' in html) is (reader == "organizers")
        if reader == "organizers":
            given = {"reason": "made apart"} if found is copy else {}
            assert (
                browser.post(f"{PAGE}/clearance", data=given | {"form_token": form_token(browser)}).status_code == 303
            )
    assert done == ["made apart", None]
