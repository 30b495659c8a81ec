import gzip
from uuid import uuid4

import pytest
from played_episodes import ask_for_playback, path_of_episode
from seeded_site import BEARS, GELBOTS, SeededSite, form_token, seeded_site, words
from service_factories import TASK
from submission_steps import make_worker
from vitac.envs.tasks.definition import Family
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.registry import find_version
from vitac.server.database.states import WorkState
from vitac.server.playbacks.asking import PlaybackFile
from vitac.server.views.comparisons import PlaybackView
from vitac.web.headers import HEADERS
from vitac.web.pages import episodes
from vitac.web.pages.episodes import CLOSED, progress

JSON = {"accept": "application/json"}
FILES = {PlaybackFile.SCENE: gzip.compress(b"scene"), PlaybackFile.STILL: b"still"}
PICKED = "pick-cube"


@pytest.fixture(autouse=True)
def built_player(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server with the player, whether or not it is built here."""
    monkeypatch.setattr(episodes, "player_script", lambda: "live.js")


@pytest.fixture
def made(site: SeededSite) -> str:
    """The page of an episode whose playback is made."""
    return ask_for_playback(site, "done", state=WorkState.DONE, files=FILES)


def test_a_made_playback_is_played_with_the_still_for_those_who_cannot(site: SeededSite, made: str) -> None:
    html = site.visitor(GELBOTS).get(made).text
    version = html.partition(f'src="{made}/playback/still?v=')[2].partition('"')[0]
    assert len(version) == 64
    assert f'data-playback="{made}/playback" data-state="done" data-version="{version}"' in html
    assert "trapezoid, x −4.00 mm, y −2.00 mm, turned +2.00°" in html
    assert "success" in words(html)
    assert "data-cameras" not in html
    assert "Make the playback" not in html


def test_files_are_kept_by_the_browser_under_their_key_only(site: SeededSite, made: str) -> None:
    browser = site.visitor(GELBOTS)
    key = browser.get(made).text.partition('data-version="')[2].partition('"')[0]
    for version, kept in ((f"?v={key}", "private, max-age=31536000, immutable"), ("", "no-cache")):
        still = browser.get(f"{made}/playback/still{version}")
        assert (still.content, still.headers["content-type"]) == (b"still", "image/webp")
        assert still.headers["cache-control"] == kept
    scene = browser.get(f"{made}/playback/scene")
    assert (scene.content, scene.headers["content-encoding"]) == (b"scene", "gzip")


@pytest.mark.parametrize("file", ["cameras", "other", "..%2F..%2Fkey"])
def test_a_file_that_is_not_there_is_not_found(site: SeededSite, made: str, file: str) -> None:
    assert site.visitor(GELBOTS).get(f"{made}/playback/{file}").status_code == 404


def test_an_episode_of_maniskill_is_a_film_that_plays_only_when_it_is_asked_for(site: SeededSite) -> None:
    site.submit(GELBOTS, "cubes", {PICKED: (1,)})
    path = path_of_episode(site, "cubes", task=PICKED)
    browser = site.visitor(GELBOTS)
    nobody = browser.post(f"{path}/playback", data={"form_token": form_token(browser)})
    assert (nobody.status_code, "no running worker can draw ManiSkill" in nobody.text) == (422, True)
    make_worker(site.database, families=[Family.MANISKILL_PICTURES], evaluator_version=find_version("maniskill"))
    ask_for_playback(site, "cubes", task=PICKED, state=WorkState.DONE, files=FILM)
    html = browser.get(path).text
    assert 'data-state="filmed"' in html, "the script, which plays scenes, leaves it alone"
    film = html.partition(f'src="{path}/playback/film')[2].partition('"')[0]
    assert "<details" in html.partition(f'src="{path}/playback/film')[0]
    assert "whose states were compared with the recorded ones" in words(html)
    for absent in ("<canvas", "Keys of the player", "3D player", "Make the playback", "drawn from (0)"):
        assert absent not in html
    answer = browser.get(f"{path}/playback/film{film}")
    assert (answer.content, answer.headers["content-type"]) == (b"RIFF film", "image/webp")


FILM = {PlaybackFile.FILM: b"RIFF film", PlaybackFile.STILL: b"still"}


def test_what_does_not_repeat_says_so_and_offers_nothing(site: SeededSite, monkeypatch: pytest.MonkeyPatch) -> None:
    site.submit(GELBOTS, "cubes", {PICKED: (1,)})
    task = load_track("maniskill").tasks[PICKED]
    on_gpu = task.model_copy(update={"settings": dict(task.settings) | {"sim_backend": "physx_cuda"}})
    monkeypatch.setattr(episodes.EpisodePage, "task", on_gpu)
    html = site.visitor(GELBOTS).get(path_of_episode(site, "cubes", task=PICKED)).text
    assert "There are no playbacks of ManiSkill/PickCube-v1 with these settings: its states do not repeat" in html
    assert 'data-state="none"' in html
    for absent in ("Make the playback", "<progress", "<canvas", "note bad"):
        assert absent not in html


def test_looking_computes_nothing_and_asking_needs_the_sessions_form_token(site: SeededSite) -> None:
    path, browser = path_of_episode(site, "done"), site.visitor(GELBOTS)
    assert browser.post(f"{path}/playback", data={"form_token": "00"}).status_code == 403
    html = browser.get(path).text
    assert ("Make the playback" in html, 'data-state=""' in html) == (True, True)
    assert browser.get(f"{path}/playback", headers=JSON).status_code == 404
    asked = browser.post(f"{path}/playback", data={"form_token": form_token(browser)}, headers=JSON).json()
    assert asked["state"] == "queued"
    assert browser.get(f"{path}/playback", headers=JSON).json() == asked
    assert asked["text"] in words(browser.get(path).text)


def test_asking_comes_back_to_both_episodes(site: SeededSite) -> None:
    path, browser = path_of_episode(site, "done"), site.visitor(GELBOTS)
    with_id = f"{site.id_of('done')}:7"
    for given, kept in (("7", "?beside=7"), (with_id, f"?beside={with_id}"), ("7&x=//evil", "")):
        answer = browser.post(f"{path}/playback", data={"form_token": form_token(browser), "beside": given})
        assert (answer.status_code, answer.headers["location"]) == (303, f"{path}{kept}")


def test_a_visitor_watches_a_public_episode_and_asks_for_its_playback_within_limits() -> None:
    with seeded_site(playbacks_per_address=2) as site:
        site.publish("done")
        visitor, path = site.visitor(), path_of_episode(site, "done")
        assert "Make the playback" in visitor.get(path).text
        asked = visitor.post(f"{path}/playback", data={"beside": ""})
        assert (asked.status_code, asked.headers["location"]) == (303, path)
        assert 'data-state="queued"' in visitor.get(path).text
        hidden = visitor.post(f"{path_of_episode(site, 'both')}/playback", data={"beside": ""})
        assert hidden.headers["location"].startswith("/sign-in")
        limited = visitor.post(f"{path_of_episode(site, 'done', 6)}/playback", data={"beside": ""})
        assert limited.status_code == 429
        refused = site.visitor(BEARS).post(f"{path}/playback", data={"beside": ""})
        assert refused.status_code == 403, "who is signed in has a token to send"


def test_one_playback_too_many_is_refused_with_the_reason() -> None:
    with seeded_site(playbacks_at_once=1) as site:
        browser = site.visitor(GELBOTS)
        answers = [
            browser.post(f"{path_of_episode(site, 'done', n)}/playback", data={"form_token": form_token(browser)})
            for n in (1, 2)
        ]
    assert [answer.status_code for answer in answers] == [303, 429]
    assert "At most 1 playbacks that wait or are being made are possible" in answers[1].text


@pytest.mark.parametrize("state", [WorkState.QUEUED, WorkState.RUNNING])
def test_a_page_that_waits_reloads_itself_without_javascript(
    site: SeededSite, state: WorkState, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, browser = ask_for_playback(site, "done", state=state), site.visitor(GELBOTS)
    refresh = '<meta http-equiv="refresh" content="3">'
    assert f"<noscript>{refresh}</noscript>" in browser.get(path).text
    monkeypatch.setattr(episodes, "player_script", lambda: None)
    html = browser.get(path).text
    assert refresh in html
    assert f"<noscript>{refresh}</noscript>" not in html
    assert "The 3D player is not installed on this server" in html


def test_a_failed_playback_says_why(site: SeededSite) -> None:
    html = site.visitor(GELBOTS).get(ask_for_playback(site, "done", state=WorkState.FAILED)).text
    assert "There is no playback of this episode. The states differ." in words(html)
    assert "http-equiv" not in html


def test_progress_says_what_comes_first_and_how_far_it_is() -> None:
    def said(state: WorkState, **changes: object) -> str:
        values = {
            "key": "", "state": state, "env_steps": 3, "env_steps_played": 0, "waits_for": 0, "family": Family.TACTILE,
            "workers": 1, "problem": None, "has_cameras": False, "has_still": False,
        }  # fmt: skip
        return progress(PlaybackView.model_validate(values | changes))

    assert said(WorkState.QUEUED) == (
        "This playback is made next, as soon as a worker is free; usually within a minute."
    )
    for count, others in ((1, "Another playback is"), (32, "32 other playbacks are")):
        assert said(WorkState.QUEUED, waits_for=count) == f"{others} made first, usually in some seconds each."
    assert said(WorkState.QUEUED, workers=0) == "Waiting: no worker is running."
    for family in set(Family) - {Family.TACTILE}:  # also one to which a track's file was changed since
        stuck = said(WorkState.QUEUED, family=family, workers=0)
        assert stuck.startswith("Waiting: no running worker can draw"), family
    assert said(WorkState.RUNNING, env_steps_played=2) == "Being made: env step 2 of 3."
    assert said(WorkState.DONE) == ""


def test_two_episodes_stand_side_by_side(site: SeededSite, made: str) -> None:
    browser = site.visitor(GELBOTS)
    other, own = path_of_episode(site, "done", 6), site.id_of("done")
    for query in ("beside=6", f"beside={own}:6", "of=&beside=6", f"of={own}&beside=6"):
        html = browser.get(f"{made}?{query}").text
        assert f'data-playback="{made}/playback"' in html
        assert f'data-playback="{other}/playback"' in html
        assert html.count('class="player"') == 2
    html = browser.get(f"{made}?beside={site.id_of('both')}:6").text
    assert f'<option value="{site.id_of("both")}" selected>Gelbots: both' in html


@pytest.mark.parametrize("beside", ["six", "-6", "6 7", "x:6", ":", "99999999"])
def test_what_names_no_episode_is_refused(site: SeededSite, beside: str) -> None:
    answer = site.visitor(GELBOTS).get(f"{path_of_episode(site, 'done')}?beside={beside}")
    assert answer.status_code == 400
    assert "Expected an episode as NUMBER" in answer.text


def test_the_ends_of_the_list_have_one_neighbour(site: SeededSite) -> None:
    for number, shown, gone in ((1, "Next episode", "Previous episode"), (270, "Previous episode", "Next episode")):
        html = site.visitor(GELBOTS).get(path_of_episode(site, "done", number)).text
        assert (shown in html, gone in html) == (True, False)


def test_foreign_missing_and_malformed_episodes_look_alike(site: SeededSite) -> None:
    browser, folder = site.visitor(GELBOTS), f"{site.path_of('done')}/episodes"
    for path in (
        path_of_episode(site, "sharp"),
        f"/submissions/{uuid4()}/episodes/{TASK}/5",
        f"/submissions/not-an-id/episodes/{TASK}/5",
        path_of_episode(site, "runs", 270),
        f"{folder}/no-task/5",
        f"{folder}/{TASK}/five",
        f"{folder}/{TASK}/99999999999",
        f"{folder}/{TASK}/٥",
    ):
        for address in (path, f"{path}/playback/scene"):
            assert browser.get(address).status_code == 404, address
        assert browser.post(f"{path}/playback", data={"form_token": form_token(browser)}).status_code == 404, path


@pytest.mark.parametrize("below", ["", "/playback", "/playback/scene"])
def test_who_is_not_signed_in_is_asked_to(site: SeededSite, below: str) -> None:
    answer = site.visitor().get(path_of_episode(site, "done") + below)
    assert answer.status_code == 303
    assert answer.headers["location"].startswith("/sign-in?next=")


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
