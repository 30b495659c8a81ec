import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK
from page_service import FixedData
from visits import BOTH, COMPLETED, RUNNING, sign_in
from vitac.server.views.submissions import EpisodeOutputView

ADDRESS = f"/submissions/{BOTH.id}/output"


def printed(*episodes: int, task: str = TASK) -> list[EpisodeOutputView]:
    return [
        EpisodeOutputView(task=task, episode=number, outcome="not_converged", output=f"<b>in {number}</b>")
        for number in episodes
    ]


def test_output_is_shown_by_episode_and_escaped(data: FixedData, browser: AsgiBrowser) -> None:
    data.printed = printed(2, 7)
    sign_in(browser, "Gelbots")
    html = browser.get(ADDRESS).text
    assert html.index("Episode 2: not converged") < html.index("Episode 7: not converged")
    assert "&lt;b&gt;in 2&lt;/b&gt;" in html
    assert "<b>in" not in html
    assert "Later episodes" not in html
    assert (
        html.count("<li>not converged: The physics found no solution for an IPC step, even in smaller pieces.</li>")
        == 1
    )


def test_more_episodes_are_one_link_away(data: FixedData, browser: AsgiBrowser) -> None:
    data.printed = printed(2, 7, 9)
    sign_in(browser, "Gelbots")
    assert f'href="{ADDRESS}?task={TASK}&amp;after=7"' in browser.get(ADDRESS).text
    html = browser.get(f"{ADDRESS}?task={TASK}&after=7").text
    assert "in 9" in html
    assert "in 7" not in html


def test_why_a_policy_failed_is_told_also_where_it_printed_nothing(data: FixedData, browser: AsgiBrowser) -> None:
    (silent,) = printed(4)
    failed = {"outcome": "policy_failed", "output": "", "failure": "bad_action_shape: Action has shape <2>."}
    data.printed = [silent.model_copy(update=failed)]
    sign_in(browser, "Gelbots")
    html = browser.get(ADDRESS).text
    assert "<p>bad_action_shape: Action has shape &lt;2&gt;.</p>" in html
    assert "policy failed: The policy crashed, broke a limit or answered wrongly." in html
    assert '<pre class="log"' not in html


def test_each_task_has_its_own_output(data: FixedData, browser: AsgiBrowser) -> None:
    data.printed = [*printed(2), *printed(5, task=LOCK)]
    sign_in(browser, "Gelbots")
    html = browser.get(f"{ADDRESS}?task={LOCK}").text
    assert "in 5" in html
    assert "in 2" not in html
    assert f'href="{ADDRESS}?task={LOCK}" aria-current="page"' in html


def test_silence_is_told(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(ADDRESS).text
    assert "Nothing was printed." in html
    assert "plain-list" not in html
    assert "Nothing was printed in the episodes after 9." in browser.get(f"{ADDRESS}?after=9").text


@pytest.mark.parametrize("after", ["-1", "x", "1" * 30, "²"])
def test_a_number_that_is_none_is_refused(browser: AsgiBrowser, after: str) -> None:
    sign_in(browser, "Gelbots")
    assert browser.get(f"{ADDRESS}?after={after}").status_code == 400


def test_it_is_for_the_team_only(browser: AsgiBrowser) -> None:
    assert browser.get(ADDRESS).headers["location"] == f"/sign-in?next={ADDRESS}"
    sign_in(browser, "Bears")
    assert browser.get(ADDRESS).status_code == 404


def test_the_submissions_page_links_to_it_where_there_is_some(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    for submission in (COMPLETED, RUNNING):
        page = f"/submissions/{submission.id}"
        assert f"{page}/output" not in browser.get(page).text
    data.printed = printed(2, 7)
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    assert "It printed or failed in 2 episodes" in html
    assert f'href="/submissions/{COMPLETED.id}/output"' in html
