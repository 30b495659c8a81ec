import csv
import io
import json
import re
from collections.abc import Mapping
from uuid import UUID

import page_service
import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, TASK, a_submission, an_id, some_episodes
from page_service import FixedData
from visits import BOTH, COMPLETED, QUEUED, RUNNING, sign_in
from vitac.server.db.states import EvaluationState
from vitac.server.principals import Principal
from vitac.server.views.submissions import EpisodeView, SubmissionView
from vitac.web.pages.submission_detail import SubmissionDetail

OTHER = a_submission("Gelbots", EvaluationState.COMPLETED, name="other")
ONLY_LOCK = a_submission("Gelbots", EvaluationState.COMPLETED, name="lock", tasks=(LOCK,))


def some_ends(solved: str) -> list[EpisodeView]:
    return [
        end.model_copy(update={"outcome": "success" if mark == "x" else "steps", "success": mark == "x"})
        for mark, end in zip(solved, some_episodes(TASK, len(solved)), strict=True)
    ]


@pytest.fixture
def ends(data: FixedData, monkeypatch: pytest.MonkeyPatch) -> dict[UUID, list[EpisodeView]]:
    """Episodes of submissions, to be filled."""
    data.found = [COMPLETED, OTHER, BOTH, ONLY_LOCK, RUNNING, QUEUED]
    given: dict[UUID, list[EpisodeView]] = {}
    whole = FixedData.submission

    def submission(self: FixedData, settings: object, by: Principal, submission_id: UUID) -> SubmissionDetail:
        found = whole(self, settings, by, submission_id)
        episodes = given.get(submission_id, list(found.episodes))
        values: Mapping[str, object] = vars(found) | {"episodes": episodes}
        return SubmissionDetail(**values)  # type: ignore[arg-type]

    monkeypatch.setattr(page_service.FixedData, "submission", submission)
    return given


def shown(browser: AsgiBrowser, other: SubmissionView | None, suffix: str = "") -> str:
    sign_in(browser, "Gelbots")
    query = f"?with={other.id}" if other else ""
    answer = browser.get(f"/submissions/{COMPLETED.id}/compare{suffix}{query}")
    assert answer.status_code == 200
    return answer.text


def test_without_another_one_a_form_offers_those_that_can_be_compared(
    browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    assert ends == {}
    html = shown(browser, None)
    for offered in (OTHER, BOTH):
        assert f'<option value="{offered.id}"' in html
    for other in (COMPLETED, RUNNING, QUEUED):
        assert f'<option value="{other.id}"' not in html


def test_two_submissions_of_one_name_are_told_apart(
    data: FixedData, browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    again = COMPLETED.model_copy(update={"id": an_id("again")})
    data.found = [COMPLETED, again, OTHER]
    ends |= {COMPLETED.id: some_ends("xxo"), again.id: some_ends("xoo"), OTHER.id: some_ends("xoo")}
    html, name = shown(browser, again), COMPLETED.name
    for named in (f"Only {name} (first)</dt><dd>1</dd>", f"Only {name} (second)</dt><dd>0</dd>"):
        assert named in html
    for number, which in (("first", name), ("second", name)):
        assert f'scope="col">{which} ({number})</th>' in html
    assert "(first)" not in shown(browser, OTHER), "two names say which is which"


def test_those_of_the_track_are_offered_whatever_was_submitted_since(
    data: FixedData, browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    assert ends == {}
    later = [COMPLETED.model_copy(update={"id": an_id(f"log {n}"), "track": "track_2"}) for n in range(2)]
    data.found, data.page_size = [*later, OTHER, COMPLETED, BOTH], 2
    html = shown(browser, None)
    assert f'<option value="{OTHER.id}"' in html
    assert str(later[0].id) not in html
    assert str(BOTH.id) not in html  # on a later page, but named by the address
    assert f'<option value="{BOTH.id}" selected' in shown(browser, BOTH)


def test_counts_p_value_and_differing_episodes_are_shown(
    browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    ends[COMPLETED.id], ends[OTHER.id] = some_ends("xxxxxxx.."), some_ends("x......x.")
    html = shown(browser, OTHER)
    for name, count in (("Both solve", 1), ("Only done", 6), ("Only other", 1), ("Neither", 1)):
        assert f"<dt>{name}</dt><dd>{count}</dd>" in html
    assert "<dd>0.125</dd>" in html
    assert html.count("<tr role=") == 1 + 7
    assert f'<option value="{OTHER.id}" selected' in html
    for meaning in ("success: The task was solved.", "steps: All env steps were used up."):
        assert html.count(f"<li>{meaning}</li>") == 1


def test_each_differing_episode_leads_to_both_side_by_side(
    browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]
) -> None:
    ends[COMPLETED.id], ends[OTHER.id] = some_ends("xx."), some_ends("x.x")
    html = shown(browser, OTHER)
    links = re.findall(r'href="/submissions/([0-9a-f-]+)/episodes/([a-z-]+)/(\d+)\?beside=([0-9a-f-]+):(\d+)"', html)
    assert len(links) == 2
    for first, task, number, second, beside in links:
        assert (first, second, beside) == (str(COMPLETED.id), str(OTHER.id), number)
        assert task == "peg-insertion"


def test_all_pairs_are_a_file(browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]) -> None:
    ends[COMPLETED.id], ends[OTHER.id] = some_ends("x."), some_ends("..")
    rows = list(csv.DictReader(io.StringIO(shown(browser, OTHER, ".csv"))))
    assert [(row["episode"], row["first_outcome"], row["second_outcome"]) for row in rows] == [
        ("1", "success", "steps"),
        ("2", "steps", "steps"),
    ]


def test_counts_and_pairs_are_a_file_too(browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]) -> None:
    ends[COMPLETED.id], ends[OTHER.id] = some_ends("xxxxxxx.."), some_ends("x......x.")
    assert f'href="/submissions/{COMPLETED.id}/compare.json?with={OTHER.id}"' in shown(browser, OTHER)
    found = json.loads(shown(browser, OTHER, ".json"))
    counts = {"both": 1, "only_first": 6, "only_second": 1, "neither": 1, "unpaired": 0, "p_value": 0.125}
    assert found["result"] == counts
    assert (found["first"]["id"], found["second"]["name"]) == (str(COMPLETED.id), OTHER.name)
    assert len(found["pairs"]) == 9
    second = found["pairs"][1]
    assert (second["task"], second["episode"]) == (TASK, 2)
    assert (second["first_outcome"], second["second_outcome"]) == ("success", "steps")
    assert second["first_env_steps"] == ends[COMPLETED.id][1].env_steps
    nothing = json.loads(shown(browser, ONLY_LOCK, ".json"))
    assert (nothing["result"], nothing["pairs"]) == (None, [])
    assert json.loads(shown(browser, None, ".json"))["second"] is None


def test_nothing_in_common_is_told(browser: AsgiBrowser, ends: dict[UUID, list[EpisodeView]]) -> None:
    assert "have no episode in common" in shown(browser, ONLY_LOCK)
    ends[OTHER.id] = []
    assert "have no episode in common" in shown(browser, OTHER)


def test_other_lists_are_not_compared(data: FixedData, browser: AsgiBrowser) -> None:
    sealed = OTHER.evaluation.model_copy(update={"commitment": "c0ffee"})
    data.found = [COMPLETED, OTHER.model_copy(update={"evaluation": sealed})]
    assert "have no episode in common" in shown(browser, OTHER)


def test_different_evaluators_are_told(data: FixedData, browser: AsgiBrowser) -> None:
    data.found = [COMPLETED, OTHER]
    assert "different evaluators" not in shown(browser, OTHER)
    older = OTHER.evaluation.model_copy(update={"evaluator_version": "0+old"})
    data.found = [COMPLETED, OTHER.model_copy(update={"evaluation": older})]
    assert "different evaluators, 1+0123456789ab and 0+old" in shown(browser, OTHER)


def test_another_teams_submission_is_not_there(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    for other in (QUEUED.id, an_id("nobody"), "no-id"):
        assert browser.get(f"/submissions/{COMPLETED.id}/compare?with={other}").status_code == 404
