import gzip

import pytest
from played_episodes import ask_for_playback, path_of_episode
from seeded_site import GELBOTS, SeededSite
from vitac.server.database.states import WorkState
from vitac.server.playbacks.asking import PlaybackFile
from vitac.web.headers import HEADERS
from vitac.web.pages.episodes.embedded import CLOSED


@pytest.fixture
def path(site: SeededSite) -> str:
    """The page of an episode with a playback of a result that is not public yet."""
    return ask_for_playback(site, "done", state=WorkState.DONE, files={PlaybackFile.SCENE: gzip.compress(b"")})


def test_a_public_episode_stands_in_frames_of_other_sites_and_nothing_else_does(site: SeededSite, path: str) -> None:
    site.publish("done")
    browser = site.visitor()
    embedded = browser.get(f"/embed{path}")
    assert embedded.status_code == 200
    assert f'data-playback="/embed{path}/playback" data-state="done"' in embedded.text
    assert f'href="{path}" target="_blank"' in embedded.text
    assert "frame-ancestors *" in embedded.headers["content-security-policy"]
    assert "x-frame-options" not in embedded.headers
    for other in (path, "/", f"/embed{path}/playback/scene", "/embed/nothing"):
        headers = browser.get(other).headers
        assert headers["x-frame-options"] == "DENY", other
        assert "frame-ancestors 'none'" in headers["content-security-policy"], other
    policy = embedded.headers["content-security-policy"]
    assert policy.replace("frame-ancestors *", "frame-ancestors 'none'") == HEADERS["Content-Security-Policy"]


def test_what_is_not_public_is_refused_in_a_sentence_also_to_those_who_may_see_it(site: SeededSite, path: str) -> None:
    browser = site.visitor(GELBOTS)
    assert browser.get(path).status_code == 200
    for closed in (path, path_of_episode(site, "done", 7), "/submissions/no-id/episodes/peg-insertion/x"):
        answer = browser.get(f"/embed{closed}")
        assert answer.status_code == 404
        assert CLOSED in answer.text
        assert "frame-ancestors *" in answer.headers["content-security-policy"], "the sentence is read in the frame"
        assert "set-cookie" not in answer.headers
    assert browser.get(f"/embed{path}/playback/scene").status_code != 200


def test_a_visitor_asks_for_what_was_not_made_yet(site: SeededSite) -> None:
    site.publish("done")
    page = f"/embed{path_of_episode(site, 'done')}"
    browser = site.visitor(GELBOTS)
    answer = browser.post(f"{page}/playback", data={"beside": ""})  # without the session's token
    assert (answer.status_code, answer.headers["location"]) == (303, page)
    assert 'data-state="queued"' in browser.get(page).text


def test_code_for_frames_is_offered_where_everybody_may_see_the_episode(site: SeededSite, path: str) -> None:
    browser = site.visitor(GELBOTS)
    html = browser.get(path).text
    assert ('data-share=""' in html, 'name="frame"' in html) == (True, False)
    site.publish("done")
    html = browser.get(path).text
    assert (f'data-share="/embed{path}"' in html, 'name="frame"' in html) == (True, True)
