"""A 2025 text log in a few numbers, beside what it claims."""

from datetime import datetime

import pytest
from vitac.evaluator.logs.text_2025.checks import summarize
from vitac.evaluator.logs.text_2025.messages import TextLogRejected
from vitac.evaluator.logs.text_2025.reader import TextEpisode, TextLog
from vitac.evaluator.logs.text_2025.scripts import Script, all_scripts

PEG, LOCK, FUSION, TRACK_3, *_ = all_scripts()


def log_of(*results: bool | None, **changes: object) -> TextLog:
    """A log of peg insertion whose tests end so."""
    tests = [
        TextEpisode(line=number, number=number, started=datetime(2025, 1, 1), success=result)
        for number, result in enumerate(results, start=1)
    ]
    log = TextLog(team="Touch", script_md5=PEG.md5[0], environment=dict(PEG.environment), episodes=tests)
    for name, value in changes.items():
        setattr(log, name, value)
    return log


def test_a_log_is_summarized_beside_its_claims() -> None:
    script, summary = summarize(
        log_of(True, False, None, True, True, claimed_success_rate=0.9, claimed_average_steps=3.5)
    )
    assert script is PEG
    assert (summary.task, summary.track, summary.team) == ("peg_insertion", "Track_1", "Touch")
    assert (summary.episodes, summary.successes, summary.success_rate) == (5, 3, 0.6)
    assert (summary.claimed_success_rate, summary.claimed_average_steps) == (0.9, 3.5)
    assert (summary.script_md5, summary.era) == (PEG.md5[0], None)


def test_a_log_without_tests_has_no_successes() -> None:
    _, summary = summarize(log_of())
    assert (summary.episodes, summary.successes, summary.success_rate) == (0, 0, 0.0)
    assert (summary.claimed_success_rate, summary.claimed_average_steps) == (None, None)


def test_a_log_without_a_team_is_of_nobody() -> None:
    assert summarize(log_of(True, team=None))[1].team == ""


def test_misplaced_lines_stand_before_what_the_checks_find() -> None:
    _, summary = summarize(log_of(True, problems=["line 9: unknown message 'what'"]))
    assert summary.problems[0] == "line 9: unknown message 'what'"
    assert "expected the 270 tests of the list, got 1" in summary.problems[1:]
    assert len(set(summary.problems)) == len(summary.problems)


@pytest.mark.parametrize("script", [PEG, LOCK, FUSION, TRACK_3], ids=lambda script: script.name)
def test_a_log_is_known_by_the_settings_that_its_script_prints(script: Script) -> None:
    found, summary = summarize(log_of(environment=dict(script.environment)))
    assert found is script
    assert (summary.track, summary.task) == (found.track, found.task)


@pytest.mark.parametrize("top_mm", FUSION.hole_tops_mm)
def test_the_era_of_a_vision_log_is_that_of_its_first_start(top_mm: float) -> None:
    log = log_of(True, environment=dict(FUSION.environment))
    log.episodes[0].initial_offset = FUSION.starts(top_mm)[0].offset
    assert summarize(log)[1].era == FUSION.era(top_mm)


def test_settings_of_no_script_are_refused() -> None:
    with pytest.raises(TextLogRejected) as refused:
        summarize(log_of(environment={"gravity": 9.81}))
    assert str(refused.value) == "The environment in the header is not that of any task of the challenge."
    assert refused.value.line is None
