import csv
import io
import re
from collections.abc import Mapping
from uuid import UUID

import page_service
import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_leaderboard, a_score, a_submission, an_entry, an_id, some_episodes
from page_service import FixedData
from visits import BOTH, COMPLETED, QUEUED, RUNNING, sign_in
from vitac.server.database.states import EvaluationState
from vitac.server.principals import Principal
from vitac.server.views.submissions import EpisodeView, SubmissionView
from vitac.web.pages.submission_detail import SubmissionDetail

OTHER = a_submission("Gelbots", EvaluationState.COMPLETED, name="other")
THIRD = a_submission("Gelbots", EvaluationState.COMPLETED, name="third")
ONLY_LOCK = a_submission("Gelbots", EvaluationState.COMPLETED, name="lock", tasks=(LOCK,))


def some_ends(solved: str) -> list[EpisodeView]:
    return [
        end.model_copy(update={"outcome": "success" if mark == "x" else "steps", "success": mark == "x"})
        for mark, end in zip(solved, some_episodes(TASK, len(solved)), strict=True)
    ]


@pytest.fixture
def ends(data: FixedData, monkeypatch: pytest.MonkeyPatch) -> dict[UUID, list[EpisodeView]]:
    """Episodes of submissions, to be filled."""
    data.found = [COMPLETED, OTHER, THIRD, BOTH, ONLY_LOCK, RUNNING, QUEUED]
    given: dict[UUID, list[EpisodeView]] = {}
    whole = FixedData.submission

    def submission(self: FixedData, settings: object, by: Principal, submission_id: UUID) -> SubmissionDetail:
        found = whole(self, settings, by, submission_id)
        episodes = given.get(submission_id, list(found.episodes))
        values: Mapping[str, object] = vars(found) | {"episodes": episodes}
        return SubmissionDetail(**values)  # type: ignore[arg-type]

    monkeypatch.setattr(page_service.FixedData, "submission", submission)
    return given


def shown(browser: AsgiBrowser, *others: SubmissionView, suffix: str = "") -> str:
    sign_in(browser, "Gelbots")
    query = "&".join(f"id={one.id}" for one in (COMPLETED, *others))
    answer = browser.get(f"/compare{suffix}?{query}")
    assert answer.status_code == 200
    return answer.text


def texts(html: str) -> list[list[str]]:
    """The rows of all tables, as the texts of their cells."""
    rows = re.findall(r"<tr role=.*?</tr>", html, re.DOTALL)
    cells = [re.findall(r"<t[dh] .*?</t[dh]>", row, re.DOTALL) for row in rows]
    return [[" ".join(re.sub(r"<[^>]+>", " ", cell).split()) for cell in row] for row in cells]


def test_own_results_and_those_of_the_board_are_offered(
    data: FixedData, browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    assert ends == {}
    bears = an_entry(1, "Bears", a_score((90, 80, 71), 4.31))
    data.board = a_leaderboard(bears)
    html = shown(browser)
    for offered in (OTHER, BOTH):
        assert f'<option value="{offered.id}">' in html
    for other in (COMPLETED, RUNNING, QUEUED):
        assert f'<option value="{other.id}"' not in html
    assert f'<option value="{bears.submission_id}">Bears: policy</option>' in html


def test_the_address_below_a_submission_leads_to_the_page_of_both(browser: AsgiBrowser) -> None:
    answer = browser.get(f"/submissions/{COMPLETED.id}/compare?with={OTHER.id}")
    assert (answer.status_code, answer.headers["location"]) == (303, f"/compare?id={COMPLETED.id}&id={OTHER.id}")


def test_submissions_of_one_name_have_numbers(
    data: FixedData, browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    again = COMPLETED.model_copy(update={"id": an_id("again")})
    data.found = [COMPLETED, again, OTHER]
    ends |= {COMPLETED.id: some_ends("xxo"), again.id: some_ends("xoo"), OTHER.id: some_ends("xoo")}
    assert "Gelbots: done (1) and Gelbots: done (2)" in {row[0] for row in texts(shown(browser, again))}
    assert "Gelbots: done and Gelbots: other" in {row[0] for row in texts(shown(browser, OTHER))}


def test_three_are_compared_in_pairs_by_shape_and_by_difficulty(
    browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    ends |= {COMPLETED.id: some_ends("xxxxxxx.."), OTHER.id: some_ends("x......x."), THIRD.id: some_ends("x......x.")}
    rows = texts(shown(browser, OTHER, THIRD).replace("\N{NO-BREAK SPACE}", " "))
    names = [f"Gelbots: {name}" for name in ("done", "other", "third")]
    pairs = {row[0]: [cell.split()[-1] for cell in row[1:]] for row in rows if " and " in row[0]}
    assert pairs == {
        f"{names[0]} and {names[1]}": ["1", "6", "1", "1", "+88.1)", "0.375"],
        f"{names[0]} and {names[2]}": ["1", "6", "1", "1", "+88.1)", "0.375"],
        f"{names[1]} and {names[2]}": ["2", "0", "0", "7", "+17.8)", "1"],
    }
    assert sum("+55.6 (" in " ".join(row) and "0.125, adjusted 0.375" in " ".join(row) for row in rows) == 2
    assert ["Shape", *names] in rows
    assert next(row for row in rows if row[0] == "Trapezoid")[1].endswith("82.2 % 73.1 % to 88.8 % 74 of 90")
    assert ["Starts", *names] in rows
    quarters = [row for row in rows if row[0].endswith("starts")]
    assert [row[0] for row in quarters] == ["Far starts", "Farthest starts"], "of the others none was played"
    counts = [re.findall(r"(\d+) of (\d+)", " ".join(row)) for row in quarters]
    assert [sum(int(done) for done, _ in of) for of in zip(*filter(None, counts), strict=True)] == [7, 2, 2]


def test_each_differing_episode_leads_to_both_side_by_side(
    browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    ends[COMPLETED.id], ends[OTHER.id] = some_ends("xx."), some_ends("x.x")
    html = shown(browser, OTHER)
    links = re.findall(r'href="/submissions/([0-9a-f-]+)/episodes/([a-z-]+)/(\d+)\?beside=([0-9a-f-]+):(\d+)"', html)
    mine, other = str(COMPLETED.id), str(OTHER.id)
    assert links == [(one, TASK, n, two, n) for n in "23" for one, two in ((mine, other), (other, mine))]


def test_differing_episodes_and_the_comparison_are_files(
    browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    ends[COMPLETED.id], ends[OTHER.id] = some_ends("x.."), some_ends("...")
    rows = list(csv.DictReader(io.StringIO(shown(browser, OTHER, suffix=".csv"))))
    (row,) = rows
    assert (row["episode"], row["Gelbots: done outcome"], row["Gelbots: other outcome"]) == ("1", "success", "steps")
    assert '"p_value":1.0' in shown(browser, OTHER, suffix=".json")


def test_nothing_in_common_is_said(data: FixedData, browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]) -> None:
    assert "have no episode in common" in shown(browser, ONLY_LOCK)
    ends[OTHER.id] = []
    assert "have no episode in common" in shown(browser, OTHER)
    sealed = THIRD.evaluation.model_copy(update={"commitment": "c0ffee"})
    data.found[2] = THIRD.model_copy(update={"evaluation": sealed})
    assert "have no episode in common" in shown(browser, THIRD)


def test_different_evaluators_are_named(data: FixedData, browser: AsgiBrowser) -> None:
    data.found = [COMPLETED, OTHER]
    assert "different evaluators" not in shown(browser, OTHER)
    older = OTHER.evaluation.model_copy(update={"evaluator_version": "0+old"})
    data.found = [COMPLETED, OTHER.model_copy(update={"evaluation": older})]
    assert "different evaluators, 0+old and 1+0123456789ab" in shown(browser, OTHER)


def test_another_teams_submission_is_not_there(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    for other in (QUEUED.id, an_id("nobody"), "no-id"):
        assert browser.get(f"/compare?id={COMPLETED.id}&id={other}").status_code == 404
