from collections.abc import Mapping

from markupsafe import escape
from seeded_site import BEARS, GELBOTS, SeededSite
from service_factories import LOCK, TASK
from sqlalchemy import update
from vitac.server.database.models import EpisodeResult
from vitac.server.submissions import files


def print_in(site: SeededSite, episodes: Mapping[int, str], *, name: str = "both", task: str = TASK) -> str:
    """Have a policy print in episodes of a submission; returns the page of its output."""
    with site.evaluation(name) as (session, evaluation):
        for number, output in episodes.items():
            of_episode = (EpisodeResult.evaluation_id == evaluation.id, EpisodeResult.task == task)
            session.execute(
                update(EpisodeResult).where(*of_episode, EpisodeResult.episode == number).values(output=output)
            )
    return f"{site.path_of(name)}/output"


def test_output_is_shown_by_episode_and_task_and_escaped_with_outcomes_explained_once(site: SeededSite) -> None:
    browser, address = site.visitor(GELBOTS), f"{site.path_of('both')}/output"
    html = browser.get(address).text
    assert "Nothing was printed." in html
    assert "plain-list" not in html
    assert "Nothing was printed in the episodes after 9." in browser.get(f"{address}?after=9").text
    for after in ("-1", "x", "1" * 30, "²"):
        assert browser.get(f"{address}?after={after}").status_code == 400
    print_in(site, {268: "<b>first", 270: "second"})
    print_in(site, {5: "of locks"}, task=LOCK)
    html = browser.get(address).text
    assert html.index("Episode 268: tactile") < html.index("Episode 270: tactile")
    assert "&lt;b&gt;first" in html
    assert "<b>first" not in html
    assert html.count("<li>tactile: ") == 1
    assert "Later episodes" not in html
    of_locks = browser.get(f"{address}?task={LOCK}").text
    assert ("of locks" in of_locks, "second" in of_locks) == (True, False)
    assert f'href="{address}?task={LOCK}" aria-current="page"' in of_locks


def test_more_episodes_are_one_link_away(site: SeededSite) -> None:
    last = files.PAGE_EPISODES + 1
    address = print_in(site, {number: f"in {number}." for number in range(1, last + 1)})
    browser, older = site.visitor(GELBOTS), f"{address}?task={TASK}&after={last - 1}"
    assert f'href="{escape(older)}"' in browser.get(address).text
    html = browser.get(older).text
    assert (f"in {last}." in html, f"in {last - 1}." in html) == (True, False)


def test_why_a_policy_failed_is_told_also_where_it_printed_nothing(site: SeededSite) -> None:
    address = print_in(site, dict.fromkeys((4, 5, 6), ""), name="broke", task=LOCK)
    html = site.visitor(GELBOTS).get(address).text
    assert "<p>crashed: failed in 4. " in html
    assert "policy failed: The policy crashed, broke a limit or answered wrongly." in html
    assert '<pre class="log"' not in html


def test_it_is_for_the_team_only_and_linked_where_there_is_some(site: SeededSite) -> None:
    page = site.path_of("broke")
    assert site.visitor().get(f"{page}/output").headers["location"] == f"/sign-in?next={page}/output"
    assert site.visitor(BEARS).get(f"{page}/output").status_code == 404
    html = site.visitor(GELBOTS).get(page).text
    assert "It printed or failed in 3 episodes" in html
    assert f'href="{page}/output"' in html
    assert "/output" not in site.visitor(GELBOTS).get(site.path_of("done")).text
