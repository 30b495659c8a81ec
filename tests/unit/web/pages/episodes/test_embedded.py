import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import TASK
from page_service import FixedData
from played_episodes import KEY, a_playback, a_shown_episode
from visits import COMPLETED, sign_in
from vitac.server.database.states import WorkState
from vitac.web.headers import HEADERS
from vitac.web.pages.episodes.embedded import CLOSED


@pytest.fixture
def path(data: FixedData) -> str:
    """The page of an episode with a playback of a result that is not public yet."""
    return data.show(COMPLETED.id, a_shown_episode(a_playback()))


@pytest.fixture
def published(data: FixedData, path: str) -> str:
    data.found = [found.model_copy(update={"public": found.id == COMPLETED.id}) for found in data.found]
    return path


def test_a_public_episode_stands_in_frames_of_other_sites_and_nothing_else_does(
    browser: AsgiBrowser, published: str
) -> None:
    embedded = browser.get(f"/embed{published}")
    assert embedded.status_code == 200
    assert f'data-playback="/embed{published}/playback" data-state="done" data-version="{KEY}"' in embedded.text
    assert f'href="{published}" target="_blank"' in embedded.text
    assert "frame-ancestors *" in embedded.headers["content-security-policy"]
    assert "x-frame-options" not in embedded.headers
    for other in (published, "/", f"/embed{published}/playback/scene", "/embed/nothing"):
        headers = browser.get(other).headers
        assert (headers["x-frame-options"], "frame-ancestors 'none'" in headers["content-security-policy"]) == (
            "DENY",
            True,
        ), other
    policy = embedded.headers["content-security-policy"]
    assert policy.replace("frame-ancestors *", "frame-ancestors 'none'") == HEADERS["Content-Security-Policy"]


def test_what_is_not_public_is_refused_in_a_sentence_also_to_those_who_may_see_it(
    browser: AsgiBrowser, path: str
) -> None:
    sign_in(browser, "Gelbots")
    assert browser.get(path).status_code == 200
    for closed in (path, f"/submissions/{COMPLETED.id}/episodes/{TASK}/7", f"/submissions/no-id/episodes/{TASK}/x"):
        answer = browser.get(f"/embed{closed}")
        assert answer.status_code == 404
        assert CLOSED in answer.text
        assert "frame-ancestors *" in answer.headers["content-security-policy"], "the sentence is read in the frame"
    assert browser.get(f"/embed{path}/playback/scene").status_code != 200
    assert "set-cookie" not in answer.headers


def test_a_visitor_asks_for_what_was_not_made_yet(data: FixedData, browser: AsgiBrowser, published: str) -> None:
    place = next(iter(data.episodes))
    data.episodes[place] = a_shown_episode(None)
    sign_in(browser, "Gelbots")
    answer = browser.post(f"/embed{published}/playback", data={"beside": ""})  # without the session's token
    assert (answer.status_code, answer.headers["location"]) == (303, f"/embed{published}")
    playback = data.episodes[place].playback
    assert playback is not None
    assert playback.state is WorkState.QUEUED


def test_code_for_frames_is_offered_where_everybody_may_see_the_episode(
    data: FixedData, browser: AsgiBrowser, path: str
) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(path).text
    assert ('data-share=""' in html, 'name="frame"' in html) == (True, False)
    data.set_public(data.visitors[0], COMPLETED.id, public=True)
    html = browser.get(path).text
    assert (f'data-share="/embed{path}"' in html, 'name="frame"' in html) == (True, True)
