import re
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import pytest
from seeded_site import DONE, GELBOTS, ORGANIZERS, SeededSite
from service_factories import LOCK, TASK
from vitac.envs.tasks.definition import SURFACE_DIFF
from vitac.evaluator.ranking import make_ranking
from vitac.server.database.states import EvaluationState
from vitac.server.views.leaderboards import PastResultView
from vitac.web.pages.submissions import submissions


def test_a_complete_submission_has_plots_with_tables_that_links_of_the_page_save(site: SeededSite) -> None:
    browser, path = site.visitor(GELBOTS), site.path_of("both")
    html = browser.get(path).text
    for key in (f"offsets-{TASK}-cuboid", f"offsets-{LOCK}-key4", f"shapes-{TASK}", f"steps-{LOCK}"):
        assert f'<figcaption id="{key}">' in html
        assert f'aria-labelledby="{key}"' in html
    plots = html.count("<figure")
    assert plots >= 3 + 4 + 2 + 2
    assert html.count("<summary>Table") == plots
    assert "style=" not in html
    links = re.findall(r'href="(\?[^"]*plot=[^"]+)" download', html)
    assert len(links) == 2 * plots
    begins = {"svg": b"<svg", "pdf": b"%PDF-1.4"}
    for link in links:
        assert browser.get(path + link).content.startswith(begins[link.rpartition(".")[2]]), link
    assert browser.get(f"{path}?plot=none.svg").text.startswith("<!doctype html>")


def test_only_complete_ones_have_plots(site: SeededSite) -> None:
    for name in ("runs", "broke"):
        assert 'id="offsets-' not in site.visitor(GELBOTS).get(site.path_of(name)).text


def test_the_history_marks_the_submission_that_is_shown(site: SeededSite) -> None:
    html = site.visitor(GELBOTS).get(site.path_of("done")).text
    assert "Submissions so far" in html
    assert html.count('class="point own"') == 1
    assert f'id="history-{TASK}"' in html
    assert f'id="history-{LOCK}"' not in html


def test_the_history_shows_what_the_board_of_the_task_compares_first() -> None:
    ranked_by = make_ranking(["surface_diff_mm", "submitted_at"], [SURFACE_DIFF]).compared_first
    past = [
        PastResultView(
            task=TASK,
            submission_id=uuid4(),
            submission_name=f"{value}",
            submitted_at=datetime(2031, 1, day, tzinfo=UTC),
            success_rate=0.5,
            ranked_by=ranked_by,
            value=value,
        )
        for day, value in enumerate((0.75, None, 0.25), start=1)
    ]
    evaluation = SimpleNamespace(state=EvaluationState.COMPLETED, id=uuid4(), scores=[])
    found: Any = SimpleNamespace(id=past[0].submission_id, tasks=[TASK], evaluation=evaluation)
    site: Any = SimpleNamespace(plots=SimpleNamespace(get=lambda _, make: make()))
    (history,) = submissions.figures(site, found, {TASK: "Peg"}, [], past)["history"]
    assert len(history.table.rows) == 2, "one has no such value"
    assert history.summary.endswith("the best is 0.25 with 0.25."), "less motion is better"


def test_a_sealed_list_has_no_map_by_the_track_files_starts_and_its_team_no_plots_of_episodes(site: SeededSite) -> None:
    site.submit(GELBOTS, "sealed", DONE)
    site.seal("sealed")
    for who, sees_episodes in ((GELBOTS, False), (ORGANIZERS, True)):
        html = site.visitor(who).get(site.path_of("sealed")).text
        assert 'id="offsets-' not in html
        assert (f'id="steps-{TASK}"' in html) == sees_episodes
        assert f'id="shapes-{TASK}"' in html
        assert ("episodes/peg-insertion/" in html) == sees_episodes


def test_plots_are_made_once_for_an_evaluation(site: SeededSite, monkeypatch: pytest.MonkeyPatch) -> None:
    browser, path = site.visitor(GELBOTS), site.path_of("done")
    first = browser.get(path).text
    monkeypatch.setattr(submissions, "offset_maps", lambda *_: pytest.fail("They were made again."))
    assert browser.get(path).text == first
