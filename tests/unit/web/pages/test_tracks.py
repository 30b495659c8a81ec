import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest
from asgi_browser import AsgiBrowser
from cubes_track import FILE
from PIL import Image
from recorded_forces import some_forces
from seeded_site import BEARS, GELBOTS, ORGANIZERS, SeededSite, words
from service_factories import TASK, TRACK, forget_boards
from sqlalchemy import update
from vitac.evaluator.scoring.score import summarize_forces
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import list_tracks, load_track
from vitac.server.competitions.applying import freeze_boards
from vitac.server.competitions.sealing import seal
from vitac.server.database.models import BoardResult, Evaluation
from vitac.server.decisions.finishing import finalize
from vitac.server.principals import CONSOLE
from vitac.server.tracks import sort_challenge_first
from vitac.web.pages.leaderboards import PAGE_ENTRIES, PLOTTED, accepts_logs, track_tabs
from vitac.web.pages.tracks import PICTURES
from vitac.web.rendering import STATIC

from competitions import FIRST, make_competition, moved, open_now, sealed_competition, stored_stage


def test_the_board_ranks_all_tasks_together_and_shows_each(site: SeededSite) -> None:
    site.score("Wolves", "one task", 40)
    html = site.visitor().get("/tracks/track_1").text.replace("\N{NO-BREAK SPACE}", " ")
    shown = words(html)
    for text in ("73.3 %", "68.3 % to 77.9 %", "86.7 %", "234 of 270", "4.50 env steps", "96 of 160"):
        assert text in shown
    earned = "of all tasks; 14.8 % in peg insertion alone, 40 of 270"
    assert html.index("Bears") < html.index('"rate-number">7.4 %<') < html.index(earned) < html.index("not submitted")
    assert '"rate-number">14.8 %<' not in html, "the number that ranks is the large one"
    assert "mean of the success rates of all tasks" in shown


def test_a_task_has_a_leaderboard_of_its_own_with_rates_by_shape(browser: AsgiBrowser) -> None:
    assert f'href="/tracks/track_1?task={TASK}"' in browser.get("/tracks/track_1").text
    html = browser.get(f"/tracks/track_1?task={TASK}").text
    shown = words(html)
    for text in ("Trapezoid", "85.0 % to 92.4 %, 241 of 270", "4.51", "93.3 %"):
        assert text in shown
    assert "<dd>270</dd>" in html
    assert "Key1" not in shown
    assert f'href="/tracks/track_1?task={TASK}" aria-current="page"' in html
    assert browser.get("/tracks/track_1?task=nothing").status_code == 404


def test_the_board_of_a_task_shows_the_median_peak_force_where_it_is_recorded(site: SeededSite) -> None:
    page = f"/tracks/track_1?task={TASK}"
    assert "Peak force, median" not in site.visitor().get(page).text
    forces = summarize_forces([some_forces(24.5)])
    assert forces is not None
    with site.evaluation("sharp") as (_, evaluation):
        evaluation.scores = [score | {"forces": forces.model_dump(mode="json")} for score in evaluation.scores or ()]
    forget_boards()
    shown = words(site.visitor().get(page).text)
    assert "Peak force, median" in shown
    assert "24.5 N" in shown


def test_a_page_of_many_teams_stays_small_and_its_plot_shows_the_best(site: SeededSite) -> None:
    site.fill_board(PAGE_ENTRIES + PLOTTED)
    html = site.visitor().get("/tracks/track_1").text
    assert html.count('<tr role="row" class') >= PAGE_ENTRIES
    by_date = re.findall(r"<figure.*?</figure>", html, re.DOTALL)[0]
    assert by_date.count('class="point"') == PLOTTED
    assert len(html) < 170_000


def test_baselines_stand_below_the_entries_without_a_rank_and_on_an_empty_board(site: SeededSite) -> None:
    page = f"/tracks/track_1?task={TASK}"
    assert 'class="reference"' not in site.visitor().get(f"{page}&q=bears").text
    for _ in range(2):
        rows = site.visitor().get(page).text.split('class="reference"')[1:]
        assert len(rows) == 2
        assert "peg insertion trained" in rows[0]
        assert "211 of 270" in rows[0]
        assert re.findall(r"</span> ([0-9.]+).%</td>", rows[0]) == ["83.3", "86.7", "64.4"], "by shape"
        assert 'type="checkbox"' not in rows[0] + rows[1]
        with site.database.transaction() as session:
            session.execute(update(BoardResult).values(is_off_boards=True))
        forget_boards()


def test_entry_of_another_evaluator_version_has_no_rank(site: SeededSite) -> None:
    with site.evaluation("sharp") as (session, evaluation):
        for table, of_evaluation in ((Evaluation, Evaluation.id), (BoardResult, BoardResult.evaluation_id)):
            session.execute(update(table).where(of_evaluation == evaluation.id).values(evaluator_version="0+old"))
    forget_boards()
    html = site.visitor().get("/tracks/track_1").text
    assert "evaluator 0+old, not comparable" in words(html)
    assert "1 of 2 entries has no rank" in words(html)
    assert "<code>vitac admin" in html
    assert "<dt>Teams ranked</dt><dd>1</dd>" in html


def test_a_public_page_that_a_browser_has_is_not_sent_again_until_it_changes(site: SeededSite) -> None:
    browser = site.visitor()
    tag = browser.get("/tracks/track_1").headers["etag"]
    assert browser.get("/tracks/track_1", headers={"If-None-Match": tag}).status_code == 304
    site.score("<b>Wolves</b>", "new", 250)
    changed = browser.get("/tracks/track_1", headers={"If-None-Match": tag})
    assert (changed.status_code, "&lt;b&gt;Wolves" in changed.text, "<b>Wolves" in changed.text) == (200, True, False)


def test_submission_is_linked_for_its_own_team_only(site: SeededSite) -> None:
    link = f'href="{site.path_of("sharp")}"'
    for name, is_linked in ((None, False), (GELBOTS, False), (BEARS, True), (ORGANIZERS, True)):
        assert (link in site.visitor(name).get("/tracks/track_1").text) is is_linked


def test_organizers_see_results_that_frozen_boards_do_not_show_to_others(site: SeededSite) -> None:
    site.hold(open_now(make_competition()))
    with site.database.transaction() as session:
        freeze_boards(session, CONSOLE)
    site.score("Newcomers", "late", 260)
    for address in ("/tracks/track_1", "/tracks/track_1/leaderboard.csv"):
        for name, sees_all in ((None, False), (BEARS, False), (ORGANIZERS, True)):
            assert ("Newcomers" in site.visitor(name).get(address).text) is sees_all


def test_rules_begin_with_the_scene_of_each_task_and_show_the_track_file_limits_and_commands(
    browser: AsgiBrowser,
) -> None:
    html = browser.get("/tracks/track_1/rules").text
    for name in load_track("track_1").tasks:
        (scene,) = re.findall(rf'src="(/static/{name}\.webp\?v=\w+)" width="896" height="560"', html)
        sensors = re.findall(rf'src="(/static/{name}-(?:left|right)\.webp\?v=\w+)"', html)
        assert len(sensors) == 2
        assert html.index("<h1>") < html.index(scene) < html.index(sensors[0]) < html.index('id="taking-part"')
        assert browser.get(scene).headers["content-type"] == "image/webp"
    for shown in ("marker_flow", "(2, 2, 128, 2) float32", "relative_motion", "theta", "4 degree", "1.5 mm"):
        assert shown in html
    assert "Processes" in html
    assert '\nvitac register "TEAM NAME"\nvitac submit FOLDER</code>' in unescape(html)


def test_unknown_track_is_a_page_that_names_the_known_ones(browser: AsgiBrowser) -> None:
    answer = browser.get("/tracks/track_9")
    assert answer.status_code == 404
    assert "track_1" in answer.text
    assert browser.get("/tracks/track_9/rules").status_code == 404


def test_the_board_of_a_public_list_is_for_practice(site: SeededSite) -> None:
    html = site.visitor().get("/tracks/track_1").text
    assert "<dt>Episode list</dt><dd>public</dd>" in html
    assert "Tactile manipulation: practice</h1>" in html
    assert "can recognise its episodes by their first observation" in html
    site.hold(open_now(sealed_competition()))
    with site.database.transaction() as session:
        seal(session, CONSOLE, stored_stage(session, TRACK, FIRST))
    forget_boards()
    assert "practice</h1>" not in site.visitor().get("/tracks/track_1").text


def test_all_pages_of_a_competition_that_ranks_on_a_public_list_say_so(site: SeededSite) -> None:
    site.hold(open_now(make_competition()))
    browser = site.visitor()
    for address in ("/", "/tracks/track_1", "/tracks/track_1/logs", "/tracks/track_1/rules", "/receipts", "/sign-in"):
        assert "<strong>The cup ranks on a public list:</strong>" in browser.get(address).text
    assert "ranks on a public list" not in browser.get("/competitions/other/receipts").text


def test_rules_of_track_2_show_keys_shapes_actions_limits_and_a_picture_of_the_camera(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_2/rules").text
    task = load_track("track_2").tasks["fusion-insertion"]
    for row in task.observables:
        assert f"<code>{row.name}</code></th>" in html
        assert f"({', '.join(map(str, row.shape))}) {row.dtype}" in html
    for action in task.actions:
        assert f"<code>{action.name}</code></th>" in html
    assert "<code>gt_direction</code></th>" not in html
    assert "<code>observation_keys</code>" in html
    shown = re.findall(r'<img class="wide" src="(/static/fusion-insertion[\w-]*\.webp\?v=\w+)"', html)
    assert [picture.partition("insertion")[2].partition(".")[0] for picture in shown] == [
        "",
        "-left",
        "-colour",
        "-depth",
    ]
    assert {browser.get(picture).headers["content-type"] for picture in shown} == {"image/webp"}


def test_rules_of_a_variant_show_what_is_drawn_from_which_range(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1_peg_robust/rules").text
    for shown in ("Drawn for every episode", "clearance_mm", "0.5 to 2 mm", "Clearance of the hole per side"):
        assert shown in html
    assert "Drawn for every episode" not in browser.get("/tracks/track_1/rules").text


@pytest.mark.parametrize(
    ("track", "name"),
    [("track_1", "challenge-2025"), ("track_2", "challenge-2025"), ("track_1_peg_robust", "arena-2")],
)
def test_rules_name_the_contact_model(browser: AsgiBrowser, track: str, name: str) -> None:
    html = browser.get(f"/tracks/{track}/rules").text
    assert set(re.findall(r'href="/docs/contact">([\w-]+)</a>', html)) == {name}


def test_rules_of_maniskills_track_come_from_its_environments(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/maniskill/rules").text
    for shown in ("36 to 38 extra_tcp_to_obj_pos [m]", "(42) float32", "<code>gripper</code>", "0.1 m", "-0.1 rad"):
        assert shown in html
    (picture,) = re.findall(
        r'<img class="wide" src="(/static/scene-PickCube-v1\.jpg\?v=\w+)" width="480" height="360"', html
    )
    assert browser.get(picture).headers["content-type"] == "image/jpeg"
    assert "There is no picture of this task" not in browser.get("/tracks/track_1/rules").text
    assert "within tolerance, by its outcomes" not in html
    assert "<dt>Control mode</dt><dd><code>pd_ee_delta_pos</code></dd>" in html
    assert '<p class="eyebrow">ManiSkill · Rules</p>' in html
    assert "1 1</td>" not in html, "a number without a unit has none"
    assert "Logs instead of models" in html
    assert "2025 text logs" not in html
    track_1 = browser.get("/tracks/track_1/rules").text
    assert "Control mode" not in track_1
    assert '<p class="eyebrow">Track 1 · Rules</p>' in track_1
    assert "2025 text logs are accepted too" in track_1


def test_a_task_on_a_gpu_says_that_it_does_not_repeat_and_one_without_a_picture_that_there_is_none(
    browser: AsgiBrowser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = FILE.replace("obs_mode: state", "obs_mode: state, sim_backend: physx_cuda").replace(
        "name: cubes", "name: gpu"
    )
    (tmp_path / "gpu.yaml").write_text(listed)
    many = listed.replace("name: gpu", "name: many").replace("physx_cuda", "physx_cuda, batch_size: 8")
    (tmp_path / "many.yaml").write_text(many.replace("folder: Cubes", "folder: Many"))
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))
    monkeypatch.setattr("vitac.web.pages.tracks.STATIC", tmp_path)
    html = browser.get("/tracks/gpu/rules").text
    assert "a log is verified within tolerance, by its outcomes" in html
    assert "and one evaluator version, except in the tasks that say otherwise." in html
    assert "There is no picture of this task" in html
    assert "Pictures come from the graphics driver" not in html
    assert "episodes at once" not in html
    assert "A GPU plays 8 episodes at once, each with a policy of its own." in browser.get("/tracks/many/rules").text


def test_a_task_with_pictures_says_what_of_it_does_not_repeat(
    browser: AsgiBrowser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "seen.yaml").write_text(FILE.replace("obs_mode: state", "obs_mode: rgbd").replace("cubes", "seen"))
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))
    html = browser.get("/tracks/seen/rules").text
    assert "their last bits differ from machine to machine" in html
    assert "No state depends on them" in html
    for key in ("base_camera_rgb", "base_camera_depth", "(128, 128, 3) uint8", "(128, 128, 1) int16"):
        assert key in html
    assert "and one evaluator version.</li>" in html
    assert "within tolerance, by its outcomes" not in html


@pytest.mark.parametrize("name", sorted(PICTURES))
def test_pictures_have_the_size_that_pages_reserve_for_them(name: str) -> None:
    for picture in PICTURES[name]:
        with Image.open(STATIC / picture.file) as opened:
            assert opened.size == (picture.width, picture.height)


@pytest.mark.parametrize("track", ["track_1", "track_2"])
def test_contents_of_the_rules_lead_to_every_section_in_its_order(browser: AsgiBrowser, track: str) -> None:
    html = browser.get(f"/tracks/{track}/rules").text
    contents = html.partition('aria-label="Contents"')[2].partition("</nav>")[0]
    targets = re.findall(r'href="#([\w-]+)"', contents)
    assert targets == re.findall(r'<h2 id="([\w-]+)">', html)
    assert targets[0] == "taking-part"


def test_every_track_is_reached_from_the_leaderboard_and_the_rules_of_another(site: SeededSite) -> None:
    names, shared = sort_challenge_first(list_tracks()), site.app.state.site
    for page_of_track in ("", "/rules"):
        shown = track_tabs(shared, load_track("track_1"), page_of_track)
        assert [tab.target for tab in shown] == [f"/tracks/{name}{page_of_track}" for name in names]
        assert [tab.current for tab in shown] == [name == "track_1" for name in names]
        assert [tab.title for tab in shown] == [load_track(name).title for name in names]
        assert [tab.further for tab in shown] == 3 * [False] + (len(names) - 3) * [True]
    assert names[:3] == ("track_1", "track_2", "track_3")


def test_tracks_that_are_not_the_challenges_own_stand_under_a_fold_that_is_open_on_their_pages(
    browser: AsgiBrowser,
) -> None:
    for track, is_open in (("track_2", False), ("track_2_robust", True)):
        first, fold = browser.get(f"/tracks/{track}").text.partition('aria-label="Tracks"')[2].split("<details", 1)
        assert fold.startswith(" open>") == is_open
        assert first.count("/tracks/track_") == 3
        assert 'href="/tracks/maniskill"' in fold
    front = browser.get("/").text.partition('id="tracks"')[2]
    assert "Sensor structure design" in front.partition("<details>")[0]
    assert "Tactile-vision fusion, robust" in front.partition("<details>")[2]


def test_logs_of_other_tracks_are_one_link_away_where_they_are_accepted(site: SeededSite) -> None:
    only_models = load_track("track_1").model_copy(update={"accepts": (SubmissionKind.MODEL,)})
    assert not accepts_logs(only_models)
    track, names = load_track("track_1"), site.app.state.site.tracks
    shown = track_tabs(site.app.state.site, track, "/logs", has_page=lambda one: not one.has_sensor)
    assert [tab.target for tab in shown] == [f"/tracks/{name}/logs" for name in names if name != "track_3"]
    html = site.visitor().get("/tracks/track_1/logs").text
    assert html.count('aria-label="Tracks"') == 1
    assert '<a href="/tracks/track_1/logs" aria-current="page">' in html


def test_a_single_track_needs_no_links_to_tracks(site: SeededSite) -> None:
    alone = replace(site.app.state.site, tracks=("track_1",))
    assert track_tabs(alone, load_track("track_1"), "") == ()


def test_a_stage_is_kept_by_all_links_of_its_board(site: SeededSite) -> None:
    site.hold(open_now(make_competition()))
    site.score(BEARS, "staged", 200)
    browser = site.visitor()
    html = browser.get(f"/tracks/track_1?stage={FIRST}").text
    for address in ("/tracks/track_1/leaderboard.csv", "/api/v1/leaderboards/track_1", "/tracks/track_1/logs"):
        assert f'href="{address}?stage={FIRST}"' in html
    assert f'href="/tracks/track_1?task=peg-insertion&amp;stage={FIRST}"' in html
    named = browser.get(f"/tracks/track_1/leaderboard.csv?stage={FIRST}").headers["content-disposition"]
    assert f"track_1-{FIRST}-all.csv" in named
    logs = browser.get(f"/tracks/track_1/logs?stage={FIRST}").text
    assert f'href="/tracks/track_1?stage={FIRST}"' in logs


def test_rows_show_the_ranks_that_chance_allows(site: SeededSite) -> None:
    assert "by chance rank 1 to 2" in words(site.visitor().get("/tracks/track_1").text)
    site.score("Wolves", "sure", 5)
    row = words(site.visitor().get("/tracks/track_1").text).partition("3 Wolves")[2]
    assert "by chance" not in row.partition("Compare")[0]


def test_boards_of_models_and_logs_say_since_when_they_are_final(site: SeededSite) -> None:
    content = open_now(make_competition())
    site.hold(content)
    pages = [f"/tracks/track_1{page}?stage={FIRST}" for page in ("", "/logs")]
    for page in pages:
        assert 'href="/competition/archive"' not in site.visitor().get(page).text
    site.hold(moved(content, days=-120))
    with site.database.transaction() as session:
        finalize(session, CONSOLE)
    for page in pages:
        html = site.visitor().get(page).text
        assert "final since" in html, page
        assert 'href="/competition/archive"' in html
