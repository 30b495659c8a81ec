import gzip
import json
import re
import struct
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from PIL import Image
from played_episodes import ask_for_playback, real_files
from seeded_site import GELBOTS, SeededSite, words
from service_factories import TASK, TRACK, forget_boards
from sqlalchemy import update
from vitac.evaluator.tracks import load_track
from vitac.server.accounts.messages import publish_announcement
from vitac.server.api.conditional import compress
from vitac.server.competitions.sealing import seal
from vitac.server.database.models import Submission, Team
from vitac.server.database.states import WorkState
from vitac.server.leaderboards.baselines import HUMAN, publish_human_baseline
from vitac.server.playbacks.asking import PlaybackFile
from vitac.server.principals import CONSOLE
from vitac.web.pages import home
from vitac.web.pages.tracks import find_scene
from vitac.web.rendering import STATIC

from competitions import FIRST, make_competition, moved, open_now, sealed_competition, stored_stage


def first_card(html: str) -> str:
    """What the front page says of the first track."""
    return words(html.partition('id="tracks"')[2].partition("</li>")[0])


def test_an_empty_arena_says_what_it_is_and_how_to_be_the_first(site: SeededSite) -> None:
    with site.database.transaction() as session:
        session.execute(update(Team).values(disqualified_at=Team.created_at, disqualified_for="test"))
    html = site.visitor().get("/").text
    for shown in ("ViTac Arena</h1>", "Be the first", "Open for practice", "0 teams ranked", "/docs/"):
        assert shown in html
    assert 'aria-current="page"' not in html.split("<main")[0]
    assert "/competition" not in html
    assert 'data-share=""' in html, "there is no frame of our example"


def test_names_in_any_script_stand_apart_from_the_numbers_beside_them(site: SeededSite) -> None:
    team, name = "مختبر اللمس", "سياسة"
    with site.database.transaction() as session:
        session.execute(update(Team).where(Team.name == GELBOTS).values(name=team))
        session.execute(update(Submission).where(Submission.name == "both").values(name=name))
    html = site.visitor().get("/").text
    # Without isolation a browser draws the rate after an Arabic name in front of it.
    assert f"<bdi>{team}</bdi>: " in html
    assert f"first <bdi>{team}</bdi> with " in html
    assert html.count(team) == html.count(f"<bdi>{team}</bdi>")
    assert html.count(name) == html.count(f"<bdi>{name}</bdi>") == 1
    assert f'class="team"><bdi>{team}</bdi>' in site.visitor().get("/tracks/track_1").text


def test_ways_in_are_buttons_and_each_card_leads_to_its_board_and_rules(browser: AsgiBrowser) -> None:
    html = browser.get("/").text
    assert '<a class="button" href="/tracks/track_1/rules#taking-part">Take part</a>' in html
    assert '<a class="button plain" href="/docs/">Documentation</a>' in html
    assert '<a href="/docs/demonstrations#by-hand">Play with your own keyboard</a>' in html
    assert 'id="by-hand"' in browser.get("/docs/demonstrations").text
    cards = html.partition('class="cards"')[2].partition("</ul>")[0]
    assert cards.count("board<span") == cards.count('">Rules<') == cards.count("<li>") >= 1


def test_who_plays_by_hand_is_told_which_row_of_which_board_to_beat(site: SeededSite) -> None:
    challenge = site.visitor().get("/").text.partition("Can you do it by touch alone?")[2].partition("</p>")[0]
    assert f"<code>./vitac play {TASK}</code>" in challenge
    address = re.findall(r'href="(/tracks/[^"]+)"', challenge)
    assert address == [f"/tracks/{TRACK}?task={TASK}"]
    [row] = re.findall(r'<tr role="row" class="reference">.*?</tr>', site.visitor().get(address[0]).text, re.DOTALL)[:1]
    said = r"is (.+), a policy that solves (.+) \((.+) to (.+)\) of the public list"
    [(name, rate, low, high)] = re.findall(said, words(challenge))
    for shown in (name, rate, f"{low} to {high}"):
        assert shown in words(row)


def test_people_are_the_row_to_beat_where_they_solved_most(site: SeededSite) -> None:
    with site.database.transaction() as session:
        publish_human_baseline(session, CONSOLE, TRACK, TASK, [("cuboid", True, 4, {})] * 20)
    forget_boards()
    challenge = words(site.visitor().get("/").text).partition("Can you do it by touch alone?")[2]
    assert f"The row to beat is {HUMAN} , who solved 100.0 % (" in challenge
    board = words(site.visitor().get(f"/tracks/{TRACK}?task={TASK}").text)
    assert f"{HUMAN} baseline, on starts like those of the list 100.0 %" in board


def test_where_no_board_has_baselines_none_is_named_to_beat(site: SeededSite) -> None:
    site.hold(open_now(sealed_competition()))
    with site.database.transaction() as session:
        seal(session, CONSOLE, stored_stage(session, TRACK, FIRST))
    forget_boards()
    challenge = site.visitor().get("/").text.partition("Can you do it by touch alone?")[2].partition("</p>")[0]
    assert f"./vitac play {TASK}" in challenge
    assert "/tracks/" not in challenge


def test_what_happened_lately_comes_first_and_links_what_is_public(site: SeededSite) -> None:
    for number in range(home.NEWS + 1):
        site.score(f"Team {number}", f"<{number}>", 250 - number)
    newest = f"<{home.NEWS}>"
    site.publish(newest)
    html = site.visitor().get("/").text
    recent = html.split('id="recent"')[1]
    shown = words(recent)
    assert recent.count("<li>") == home.NEWS
    places = [shown.index(f"<{number}>") for number in range(home.NEWS, 0, -1)]
    assert places == sorted(places)
    assert "<0>" not in shown
    assert f'<a href="{site.path_of(newest)}">' in recent
    assert "% in peg insertion, rank " in shown
    assert recent.count("<img") == home.NEWS, "the picture of its track stands in place of a still"
    assert "1 evaluation runs now, 1 in the queue." in shown


def test_a_card_says_whether_its_track_takes_submissions(site: SeededSite) -> None:
    for days, card in ((0, "Simulation is open until"), (-30.5, "Final opens on"), (-120, "Closed since")):
        site.hold(moved(open_now(make_competition()), days))
        html = site.visitor().get("/").text
        assert card in first_card(html)
        assert '<a class="button plain" href="/competition">The cup</a>' in html
        assert '<a href="/competition">The cup</a></h3>' in html
        assert '<li><a href="/competition">Competition</a></li>' in html
        site.hold(moved(open_now(make_competition(taken_here=False)), days))
        assert "collected elsewhere" in site.visitor().get("/").text


def test_what_everybody_asks_for_is_kept_for_seconds(site: SeededSite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.web.front.monotonic", lambda: 0.0)
    before = site.visitor().get("/").text
    site.score("Newcomers", "new", 270)
    assert site.visitor().get("/").text == before


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


def test_a_public_episode_is_played_in_place_of_ours(site: SeededSite) -> None:
    path = ask_for_playback(site, "both", 9, state=WorkState.DONE, files=dict(real_files(TASK, 5)))
    assert path not in site.visitor().get("/").text
    with site.database.transaction() as session:
        session.execute(update(Submission).where(Submission.name == "both").values(name="<b>"))
    site.publish("both")
    site.forget_front_page()
    html = site.visitor().get("/").text
    assert f'data-playback="{path}/playback" data-version="' in html
    assert f'<a href="{path}">Peg insertion, episode 9</a>, by <bdi>&lt;b&gt;</bdi> of <bdi>Gelbots</bdi>' in html
    assert "/example/playback" not in html
    assert html.count("<img") == 1 + html.count('loading="lazy"'), "only what is seen first is loaded with the page"
    assert f'src="{path}/playback/still?v=' in html, "the picture is of the episode that is played"


def test_the_newest_announcements_are_shown_and_linked(site: SeededSite) -> None:
    assert "/announcements#" not in site.visitor().get("/").text
    with site.database.transaction() as session:
        for number in range(1, home.ANNOUNCEMENTS + 2):
            publish_announcement(session, CONSOLE, title=f"<News {number}>", text="All of it.", notify=False)
    site.forget_front_page()
    html = site.visitor().get("/").text
    assert html.count("/announcements#announcement-") == home.ANNOUNCEMENTS
    newest = home.ANNOUNCEMENTS + 1
    assert f'<a href="/announcements#announcement-{newest}">&lt;News {newest}&gt;</a>' in html
    assert html.index(f"News {newest}") < html.index("News 2")
    assert "News 1" not in html
    assert "All of it." not in html


def test_a_track_has_the_picture_of_its_first_task_or_of_the_one_that_a_competition_names(site: SeededSite) -> None:
    robust = load_track("track_1_peg_robust").tasks
    assert find_scene(next(iter(robust.values()))) == "peg-insertion.webp", "that of the same environment"
    assert find_scene(None) == "markers.svg"

    def picture() -> str:
        return site.visitor().get("/").text.partition('class="cards"')[2].partition("?v=")[0]

    assert picture().endswith('src="/static/lock-opening.webp')
    content = open_now(make_competition())
    content["tracks"][TRACK]["picture"] = "fusion-insertion"
    site.hold(content)
    assert picture().endswith('src="/static/fusion-insertion.webp')
