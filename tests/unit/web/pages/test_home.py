import gzip
import json
import struct
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from markupsafe import escape
from page_fixtures import LOCK, MADE_UP_SCORES, NOW, TASK, a_leaderboard, an_entry
from page_service import FixedData, an_application
from PIL import Image
from played_episodes import KEY, a_playback, a_shown_episode, real_files
from visits import COMPLETED
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import load_track
from vitac.server.api.conditional import compress
from vitac.server.playbacks.asking import PlaybackFile
from vitac.server.views.comparisons import PublicEpisodeView, StillView
from vitac.server.views.competition import CompetitionTrackView, CompetitionView, StageView
from vitac.server.views.correspondence import AnnouncementView
from vitac.web.pages import home
from vitac.web.pages.tracks import find_scene
from vitac.web.rendering import STATIC

SCORES = (MADE_UP_SCORES[TASK], MADE_UP_SCORES[LOCK])
DAY = timedelta(days=1)


def a_stage(name: str, opens: datetime, closes: datetime, *, is_open: bool) -> StageView:
    empty = dict.fromkeys(("list_kind", "commitment", "secret", "scored_runs", "attempts", "qualified"))
    times: dict[str, Any] = {"opens": opens, "closes": closes, "is_open": is_open}
    return StageView.model_validate({"name": name, "title": name.title(), "accepts": ["model"]} | times | empty)


def a_cup(*stages: StageView, taken_here: bool = True) -> CompetitionView:
    track = CompetitionTrackView(
        name="track_1",
        title="Touch",
        taken_here=taken_here,
        ranking=["success_rate"],
        ties="",
        stages=list(stages),
        prizes=[],
    )
    return CompetitionView.model_validate(
        dict.fromkeys(("website", "contact", "teams_locked", "frozen_at", "finalized_at"))
        | {"name": "cup", "title": "The cup", "summary": "", "rules": [], "currency": "USD", "winners": []}
        | {"tracks": [track]}
    )


def test_an_empty_arena_says_what_it_is_and_how_to_be_the_first(browser: AsgiBrowser) -> None:
    html = browser.get("/").text
    for shown in ("ViTac Arena</h1>", "Be the first", "Open for practice", "0 teams ranked", "/docs/"):
        assert shown in html
    assert html.count('class="cards"') == 1
    assert 'aria-current="page"' not in html.split("<main")[0]
    assert "/competition" not in html


def test_names_in_any_script_stand_apart_from_the_numbers_beside_them(data: FixedData, browser: AsgiBrowser) -> None:
    team = "مختبر اللمس"
    data.board = a_leaderboard(an_entry(1, team, *SCORES, name="سياسة"))
    html = browser.get("/").text
    # Without isolation a browser draws the rate after an Arabic name in front of it.
    assert f"<bdi>{team}</bdi>: " in html
    assert f"first <bdi>{team}</bdi> with " in html
    assert html.count(team) == html.count(f"<bdi>{team}</bdi>")
    assert html.count("سياسة") == html.count("<bdi>سياسة</bdi>") == 1
    board = browser.get("/tracks/track_1").text
    assert f'class="team"><bdi>{team}</bdi>' in board


def test_ways_in_are_buttons_and_each_card_leads_to_its_board_and_rules(browser: AsgiBrowser) -> None:
    html = browser.get("/").text
    assert '<a class="button" href="/tracks/track_1/rules#taking-part">Take part</a>' in html
    assert '<a class="button plain" href="/docs/">Documentation</a>' in html
    cards = html.partition('class="cards"')[2].partition("</ul>")[0]
    assert cards.count('">Leaderboard<') == cards.count('">Rules<') == cards.count("<li>") >= 1


def test_what_happened_lately_comes_first_and_links_what_is_public(data: FixedData, browser: AsgiBrowser) -> None:
    entries = [
        an_entry(rank, f"Team {rank}", *SCORES).model_copy(update={"evaluated_at": NOW - rank * DAY})
        for rank in range(1, 9)
    ]
    newest = an_entry(9, "Gelbots", SCORES[0]).model_copy(
        update={"evaluated_at": NOW + DAY, "submission_id": COMPLETED.id, "submission_name": "<done>"}
    )
    stale = an_entry(None, "Old Team", *SCORES)
    data.board = a_leaderboard(*entries, newest, stale)
    data.found = [found.model_copy(update={"public": found.id == COMPLETED.id}) for found in data.found]
    data.stills[:] = [StillView(task=TASK, episode=7, outcome=EpisodeOutcome.SUCCESS, key="a")]
    html = browser.get("/").text.replace("\N{NO-BREAK SPACE}", " ")
    recent = html.split('id="recent"')[1]
    assert recent.count("<li>") == home.NEWS
    assert recent.index("&lt;done&gt;") < recent.index("Team 1") < recent.index("Team 4")
    assert "Team 5" not in recent
    assert "Old Team" not in html
    assert f'<a href="/submissions/{COMPLETED.id}">' in recent
    assert "86.7 % in peg insertion, rank 9" in recent
    assert f'<a class="thumbnail" href="/submissions/{COMPLETED.id}/episodes/{TASK}/7"><img src=' in recent
    assert (recent.count('href="/submissions/'), recent.count("/playback/still")) == (2, 1)
    assert recent.count("<img") == home.NEWS, "the picture of its track stands in place of a still"
    assert "9 teams ranked, first <bdi>Team 1</bdi> with" in html


@pytest.mark.parametrize(
    ("stages", "shown"),
    [
        ([("main", -DAY, DAY, True), ("final", 2 * DAY, 3 * DAY, False)], "Main is open until"),
        ([("main", -2 * DAY, -DAY, False), ("final", 2 * DAY, 3 * DAY, False)], "Final opens on"),
        ([("main", -2 * DAY, -DAY, False)], "Closed since"),
    ],
)
def test_a_card_says_whether_its_track_takes_submissions(
    data: FixedData,
    browser: AsgiBrowser,
    monkeypatch: pytest.MonkeyPatch,
    stages: list[tuple[str, timedelta, timedelta, bool]],
    shown: str,
) -> None:
    monkeypatch.setattr("vitac.web.front.monotonic", lambda: 0.0)
    now = datetime.now(UTC)
    made = [a_stage(name, now + opens, now + closes, is_open=is_open) for name, opens, closes, is_open in stages]
    data.cup = a_cup(*made)
    html = browser.get("/").text
    assert shown in html
    assert '<a class="button plain" href="/competition">The cup</a>' in html
    assert '<a href="/competition">The cup</a></h3>' in html
    assert '<li><a href="/competition">Competition</a></li>' in html
    data.cup = a_cup(*made, taken_here=False)
    assert "collected elsewhere" not in browser.get("/").text, "it is kept for seconds"
    assert "collected elsewhere" in AsgiBrowser(an_application(data)).get("/").text


def test_the_first_load_is_small_and_the_player_waits_for_a_click(
    browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(home, "player_script", lambda: "front.js")  # stands for the player, which may not be built
    html = browser.get("/").text
    assert "<script type=" not in html
    assert 'id="play-example" data-script="/static/front.js?v=' in html
    loaded = ("arena.css", "player.css", "front.js", "locale.js", "news.js", "mark.svg")
    sent = sum(len(compress((STATIC / name).read_bytes())) for name in loaded) + len(compress(html.encode()))
    assert sent + (STATIC / "example.webp").stat().st_size < 64 * 1024
    with Image.open(STATIC / "example.webp") as picture:
        assert f'width="{picture.width}" height="{picture.height}"' in html
    monkeypatch.setattr(home, "player_script", lambda: None)
    still = browser.get("/").text
    assert "example.webp" in still
    assert "play-example" not in still
    assert "front.js" not in still


def test_the_example_is_a_playback_as_workers_make_them_now(browser: AsgiBrowser) -> None:
    answer = browser.get("/example/playback/scene?v=1")
    assert answer.headers["content-encoding"] == "gzip"
    shipped, made = answer.content, gzip.decompress(real_files(TASK, 5)[PlaybackFile.SCENE])
    assert header_of(shipped).keys() == header_of(made).keys()
    assert header_of(shipped)["arrays"] == header_of(made)["arrays"]
    assert (STATIC / home.EXAMPLE).stat().st_size < 32 * 1024


def header_of(content: bytes) -> dict[str, Any]:
    assert content.startswith(b"VITACPB1")
    (length,) = struct.unpack_from("<I", content, 8)
    header: dict[str, Any] = json.loads(content[12 : 12 + length])
    return header


@pytest.mark.parametrize("has_cameras", [False, True])
def test_a_public_episode_is_played_in_place_of_ours(data: FixedData, browser: AsgiBrowser, has_cameras: bool) -> None:
    shown = a_shown_episode(a_playback(has_cameras=has_cameras), submission_name="<b>", number=9)
    data.public_one = PublicEpisodeView(submission_id=COMPLETED.id, shown=shown)
    html = browser.get("/").text
    address = f"/submissions/{COMPLETED.id}/episodes/{TASK}/9"
    assert f'data-playback="{address}/playback" data-version="{KEY}"' in html
    assert ("data-cameras" in html) == has_cameras
    assert f'<a href="{address}">Peg insertion, episode 9</a>, by <bdi>&lt;b&gt;</bdi> of <bdi>Gelbots</bdi>' in html
    assert str(escape(shown.story)) in html
    assert "/example/playback" not in html
    assert html.count("<img") == 1 + html.count('loading="lazy"'), "only what is seen first is loaded with the page"
    assert f'src="{address}/playback/still?v={KEY}"' in html, "the picture is of the episode that is played"


def test_the_newest_announcements_are_shown_and_linked(data: FixedData, browser: AsgiBrowser) -> None:
    assert "/announcements#" not in browser.get("/").text
    data.said = [
        AnnouncementView(id=number, title=f"<News {number}>", text="All of it.", published_at=NOW)
        for number in range(7, 1, -1)
    ]
    html = AsgiBrowser(an_application(data)).get("/").text
    assert html.count("/announcements#announcement-") == home.ANNOUNCEMENTS
    assert '<a href="/announcements#announcement-7">&lt;News 7&gt;</a>' in html
    assert html.index("News 7") < html.index("News 5")
    assert "News 4" not in html
    assert "All of it." not in html


def test_a_track_has_the_picture_of_its_first_task_or_of_the_one_that_a_competition_names(
    data: FixedData, browser: AsgiBrowser
) -> None:
    robust = load_track("track_1_peg_robust").tasks
    assert find_scene(next(iter(robust.values()))) == "peg-insertion.webp", "that of the same environment"
    assert find_scene(None) == "markers.svg"
    assert 'src="/static/lock-opening.webp?v=' in browser.get("/").text
    now = datetime.now(UTC)
    cup = a_cup(a_stage("main", now - DAY, now + DAY, is_open=True))
    data.cup = cup.model_copy(
        update={"tracks": [track.model_copy(update={"picture": "fusion-insertion"}) for track in cup.tracks]}
    )
    assert 'src="/static/fusion-insertion.webp?v=' in AsgiBrowser(an_application(data)).get("/").text
