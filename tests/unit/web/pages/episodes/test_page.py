import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import TASK, an_id
from page_service import FixedData
from played_episodes import KEY, a_playback, a_shown_episode
from visits import COMPLETED, QUEUED, form_token, sign_in
from vitac.envs.tasks.definition import Family
from vitac.evaluator.tracks import load_track
from vitac.server.database.states import WorkState
from vitac.server.playbacks.asking import PlaybackFile
from vitac.web.pages.episodes import page
from vitac.web.pages.episodes.page import EpisodeAddress, progress

JSON = {"accept": "application/json"}


@pytest.fixture
def visitor(browser: AsgiBrowser) -> AsgiBrowser:
    sign_in(browser, "Gelbots")
    return browser


@pytest.fixture(autouse=True)
def built_player(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server with the player, whether or not it is built here."""
    monkeypatch.setattr(page, "player_script", lambda: "live.js")


def show(data: FixedData, state: WorkState | None, number: int = 5) -> str:
    playback = None if state is None else a_playback(state)
    return data.show(COMPLETED.id, a_shown_episode(playback, number=number))


def test_a_made_playback_is_played_with_the_still_for_those_who_cannot(data: FixedData, visitor: AsgiBrowser) -> None:
    path = show(data, WorkState.DONE)
    html = visitor.get(path).text
    assert f'data-playback="{path}/playback" data-state="done" data-version="{KEY}"' in html
    assert f'src="{path}/playback/still?v={KEY}"' in html
    assert "trapezoid, x −4.00 mm, y −2.00 mm, turned +2.00°" in html
    assert "Solved in 3 env steps." in html
    assert "data-cameras" not in html
    assert "Make the playback" not in html


def test_an_episode_of_maniskill_is_a_film_that_plays_only_when_it_is_asked_for(
    data: FixedData, visitor: AsgiBrowser
) -> None:
    made = a_shown_episode(a_playback(family=Family.MANISKILL_PICTURES), task="pick-cube")
    place = EpisodeAddress(submission_id=COMPLETED.id, task="pick-cube", number=5)
    data.episodes[place] = made
    data.files[place] = {PlaybackFile.FILM: b"RIFF film", PlaybackFile.STILL: b"PNG still"}
    path = f"/submissions/{COMPLETED.id}/episodes/pick-cube/5"
    html = visitor.get(path).text
    assert 'data-state="filmed"' in html, "the script, which plays scenes, leaves it alone"
    assert f'src="{path}/playback/still?v={KEY}"' in html
    assert "<details" in html.partition(f'src="{path}/playback/film?v={KEY}"')[0]
    assert "whose states were compared with the recorded ones" in html
    for absent in ("<canvas", "Keys of the player", "3D player", "Make the playback", "drawn from (0)"):
        assert absent not in html
    answer = visitor.get(f"{path}/playback/film?v={KEY}")
    assert (answer.content, answer.headers["content-type"]) == (b"RIFF film", "image/webp")


def test_a_film_is_asked_for_and_waits_as_other_playbacks_do(data: FixedData, visitor: AsgiBrowser) -> None:
    path = data.show(COMPLETED.id, a_shown_episode(None, task="pick-cube"))
    html = visitor.get(path).text
    assert ("Make the playback" in html, 'data-state=""' in html) == (True, True)
    place = next(iter(data.episodes))
    nobody = a_playback(WorkState.QUEUED, family=Family.MANISKILL_PICTURES, workers=0)
    data.episodes[place] = a_shown_episode(nobody, task="pick-cube")
    assert (
        "no running worker can draw ManiSkill’s environments, which takes its packages and a Vulkan"
        in visitor.get(path).text
    )


def test_what_does_not_repeat_says_so_and_offers_nothing(
    data: FixedData, visitor: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = load_track("maniskill").tasks["pick-cube"]
    on_gpu = task.model_copy(update={"settings": dict(task.settings) | {"sim_backend": "physx_cuda"}})
    monkeypatch.setattr(page.EpisodePage, "task", on_gpu)
    html = visitor.get(data.show(COMPLETED.id, a_shown_episode(None, task="pick-cube"))).text
    assert "There are no playbacks of ManiSkill/PickCube-v1 with these settings: its states do not repeat" in html
    assert ('data-state="none"' in html, "Solved in 3 env steps." in html) == (True, True)
    for absent in ("Make the playback", "<progress", "<canvas", "note bad"):
        assert absent not in html


def test_looking_computes_nothing_and_offers_to(data: FixedData, visitor: AsgiBrowser) -> None:
    html = visitor.get(show(data, None)).text
    assert "Make the playback" in html
    assert 'data-state=""' in html
    assert data.asked == []


def test_asking_needs_the_sessions_form_token(data: FixedData, visitor: AsgiBrowser) -> None:
    path = f"{show(data, None)}/playback"
    assert visitor.post(path, data={"form_token": "00"}).status_code == 403
    assert data.asked == []
    answer = visitor.post(path, data={"form_token": form_token(visitor)})
    assert answer.status_code == 303
    assert data.asked == [EpisodeAddress(submission_id=COMPLETED.id, task=TASK, number=5)]


@pytest.mark.parametrize(
    ("beside", "kept"), [("7", "?beside=7"), (f"{COMPLETED.id}:7", f"?beside={COMPLETED.id}:7"), ("7&x=//evil", "")]
)
def test_asking_comes_back_to_both_episodes(data: FixedData, visitor: AsgiBrowser, beside: str, kept: str) -> None:
    path = show(data, None)
    answer = visitor.post(f"{path}/playback", data={"form_token": form_token(visitor), "beside": beside})
    assert answer.headers["location"] == f"{path}{kept}"


def test_the_script_asks_and_follows_by_json(data: FixedData, visitor: AsgiBrowser) -> None:
    path = f"{show(data, None)}/playback"
    assert visitor.get(path, headers=JSON).status_code == 404
    asked = visitor.post(path, data={"form_token": form_token(visitor)}, headers=JSON).json()
    assert asked["state"] == "queued"
    assert asked["text"].startswith("2 other playbacks are made first")
    assert visitor.get(path, headers=JSON).json() == asked


def test_one_playback_too_many_is_refused_with_the_reason(data: FixedData, visitor: AsgiBrowser) -> None:
    path = f"{show(data, None)}/playback"
    data.refuses_playbacks = True
    answer = visitor.post(path, data={"form_token": form_token(visitor)})
    assert answer.status_code == 429
    assert "At most 4 playbacks are possible." in answer.text


@pytest.mark.parametrize("state", [WorkState.QUEUED, WorkState.RUNNING])
def test_a_page_that_waits_reloads_itself_without_javascript(
    data: FixedData, visitor: AsgiBrowser, state: WorkState, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = show(data, state)
    refresh = '<meta http-equiv="refresh" content="3">'
    assert f"<noscript>{refresh}</noscript>" in visitor.get(path).text
    monkeypatch.setattr(page, "player_script", lambda: None)
    html = visitor.get(path).text
    assert refresh in html
    assert f"<noscript>{refresh}</noscript>" not in html
    assert "The 3D player is not installed on this server" in html


def test_a_failed_playback_says_why(data: FixedData, visitor: AsgiBrowser) -> None:
    html = visitor.get(show(data, WorkState.FAILED)).text
    assert "There is no playback of this episode. The states differ." in html
    assert "http-equiv" not in html


def test_progress_says_what_comes_first_and_how_far_it_is() -> None:
    next_one = "This playback is made next, as soon as a worker is free; usually within a minute."
    assert progress(a_playback(WorkState.QUEUED, waits_for=0)) == next_one
    for count, others in ((1, "Another playback is"), (32, "32 other playbacks are")):
        waiting = progress(a_playback(WorkState.QUEUED, waits_for=count))
        assert waiting == f"{others} made first, usually in some seconds each."
    assert progress(a_playback(WorkState.QUEUED, workers=0)) == "Waiting: no worker is running."
    for family in set(Family) - {Family.TACTILE}:  # also one to which a track's file was changed since
        stuck = a_playback(WorkState.QUEUED, family=family, workers=0)
        assert progress(stuck).startswith("Waiting: no running worker can draw"), family
    assert progress(a_playback(WorkState.RUNNING, env_steps_played=2)) == "Being made: env step 2 of 3."
    assert progress(a_playback(WorkState.DONE)) == ""


def test_two_episodes_stand_side_by_side(data: FixedData, visitor: AsgiBrowser) -> None:
    path = show(data, WorkState.DONE)
    other = show(data, WorkState.DONE, number=6)
    for query in ("beside=6", f"beside={COMPLETED.id}:6", "of=&beside=6", f"of={COMPLETED.id}&beside=6"):
        html = visitor.get(f"{path}?{query}").text
        assert f'data-playback="{path}/playback"' in html
        assert f'data-playback="{other}/playback"' in html
    assert html.count('class="player"') == 2


def test_the_result_beside_is_in_the_list_also_where_it_was_not_offered() -> None:
    own, other = EpisodeAddress(submission_id=COMPLETED.id, task=TASK, number=5), an_id("other")
    shown = a_shown_episode(a_playback(), submission_name="other", number=6)
    beside = [page.EpisodePage(address=f"/submissions/{other}/episodes/{TASK}/6", shown=shown)]
    assert page.list_results(own, (), beside) == {str(other): "Gelbots: other"}


@pytest.mark.parametrize("beside", ["six", "-6", "6 7", "x:6", ":", "99999999"])
def test_what_names_no_episode_is_refused(data: FixedData, visitor: AsgiBrowser, beside: str) -> None:
    answer = visitor.get(f"{show(data, WorkState.DONE)}?beside={beside}")
    assert answer.status_code == 400
    assert "Expected an episode as NUMBER" in answer.text


def test_the_ends_of_the_list_have_one_neighbour(data: FixedData, visitor: AsgiBrowser) -> None:
    for number, shown, gone in ((1, "Next episode", "Previous episode"), (270, "Previous episode", "Next episode")):
        html = visitor.get(show(data, None, number)).text
        assert shown in html
        assert gone not in html


def test_foreign_missing_and_malformed_episodes_look_alike(data: FixedData, visitor: AsgiBrowser) -> None:
    foreign = data.show(QUEUED.id, a_shown_episode(a_playback()))
    folder = f"/submissions/{COMPLETED.id}/episodes"
    for path in (
        foreign,
        f"/submissions/{an_id('nobody')}/episodes/{TASK}/5",
        f"/submissions/not-an-id/episodes/{TASK}/5",
        f"{folder}/{TASK}/6",
        f"{folder}/no-task/5",
        f"{folder}/{TASK}/five",
        f"{folder}/{TASK}/99999999999",
        f"{folder}/{TASK}/٥",
    ):
        assert visitor.get(path).status_code == 404, path
        assert visitor.get(f"{path}/playback/scene").status_code == 404, path
        assert visitor.post(f"{path}/playback", data={"form_token": form_token(visitor)}).status_code == 404, path


@pytest.mark.parametrize("below", ["", "/playback", "/playback/scene"])
def test_who_is_not_signed_in_is_asked_to(data: FixedData, browser: AsgiBrowser, below: str) -> None:
    answer = browser.get(show(data, WorkState.DONE) + below)
    assert answer.status_code == 303
    assert answer.headers["location"].startswith("/sign-in?next=")


def test_files_are_kept_by_the_browser_under_their_key_only(data: FixedData, visitor: AsgiBrowser) -> None:
    folder = f"{show(data, WorkState.DONE)}/playback"
    scene = visitor.get(f"{folder}/scene?v={KEY}")
    assert scene.content.startswith(b"VITACPB1")  # unpacked on the way, as a browser does
    assert scene.headers["cache-control"] == "private, max-age=31536000, immutable"
    still = visitor.get(f"{folder}/still")
    assert still.headers["content-type"] == "image/webp"
    assert still.headers["cache-control"] == "no-cache"


@pytest.mark.parametrize("file", ["cameras", "other", "..%2F..%2Fkey"])
def test_a_file_that_is_not_there_is_not_found(data: FixedData, visitor: AsgiBrowser, file: str) -> None:
    assert visitor.get(f"{show(data, WorkState.DONE)}/playback/{file}").status_code == 404
