import re

import page_service
import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_past_result
from page_service import FixedData
from visits import BOTH, COMPLETED, FAILED, RUNNING, page_of, sign_in
from vitac.web.pages.submissions import figures


def test_a_complete_submission_has_plots_with_tables(data: FixedData, browser: AsgiBrowser) -> None:
    html = page_of(data, browser, BOTH)
    for key in (f"offsets-{TASK}-cuboid", f"offsets-{LOCK}-key4", f"shapes-{TASK}", f"steps-{LOCK}"):
        assert f'<figcaption id="{key}">' in html
        assert f'aria-labelledby="{key}"' in html
    assert html.count("<figure") == html.count("<summary>Table") == 3 + 4 + 2 + 2
    assert "style=" not in html


def test_each_plot_is_saved_by_a_link_of_the_page(data: FixedData, browser: AsgiBrowser) -> None:
    links = re.findall(r'href="(\?[^"]*plot=[^"]+)" download', page_of(data, browser, BOTH))
    assert len(links) == 2 * (3 + 4 + 2 + 2)
    begins = {"svg": b"<svg", "pdf": b"%PDF-1.4"}
    for link in links:
        saved = browser.get(f"/submissions/{BOTH.id}{link}")
        assert saved.content.startswith(begins[link.rpartition(".")[2]]), link
    assert browser.get(f"/submissions/{BOTH.id}?plot=none.svg").text.startswith("<!doctype html>")


def test_others_have_none(data: FixedData, browser: AsgiBrowser) -> None:
    for submission in (RUNNING, FAILED):
        assert "<figure" not in page_of(data, browser, submission)


def test_the_history_marks_the_submission_that_is_shown(data: FixedData, browser: AsgiBrowser) -> None:
    data.past = [a_past_result("done", 0.87, 0)]
    assert "Submissions so far" not in page_of(data, browser, COMPLETED)
    data.past = [a_past_result("done", 0.87, 0), a_past_result("before", 0.5, 3), a_past_result("lock", 0.5, 3, LOCK)]
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    assert "Submissions so far" in html
    assert html.count('class="point own"') == 1
    assert f'id="history-{TASK}"' in html
    assert f'id="history-{LOCK}"' not in html


def test_who_sees_no_episodes_gets_no_plots_of_them(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert 'id="offsets-' in page_of(data, browser, COMPLETED)
    monkeypatch.setattr(page_service, "some_episodes", lambda *_: [])
    html = page_of(data, browser, COMPLETED)
    assert 'id="offsets-' not in html
    assert 'id="steps-' not in html
    assert f'id="shapes-{TASK}"' in html


def test_a_stages_own_list_has_no_map_by_the_track_files_starts(data: FixedData, browser: AsgiBrowser) -> None:
    evaluation = COMPLETED.evaluation.model_copy(update={"commitment": "c0ffee"})
    html = page_of(data, browser, COMPLETED.model_copy(update={"evaluation": evaluation}))
    assert 'id="offsets-' not in html
    assert f'id="steps-{TASK}"' in html


def test_plots_are_made_once_for_an_evaluation(browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch) -> None:
    sign_in(browser, "Gelbots")
    first = browser.get(f"/submissions/{COMPLETED.id}").text
    monkeypatch.setattr(figures, "offset_maps", lambda *_: pytest.fail("They were made again."))
    assert browser.get(f"/submissions/{COMPLETED.id}").text == first
