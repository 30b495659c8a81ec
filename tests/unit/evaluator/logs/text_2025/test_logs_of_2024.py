"""Logs in the format of 2024: no MD5, no git, no info or reward; read, checked and turned into recordings of ours."""

import io
from collections.abc import Iterator
from pathlib import Path

import pytest
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.logs.resimulation import read_recordings
from vitac.evaluator.logs.text_2025 import TextLog, find_script, read_text_log, summarize
from vitac.evaluator.logs.text_2025.recordings import (
    explain_not_resimulated,
    text_log_recordings,
    track_and_task_names,
)
from vitac.evaluator.logs.text_2025.scripts import Script, all_scripts
from vitac.evaluator.tracks import load_track

SCRIPTS = {script.task: script for script in all_scripts() if not script.md5}
PEG, LOCK = SCRIPTS["peg_insertion"], SCRIPTS["open_lock"]
PREFIX = "2024-04-20 10:14:25.878 | INFO     | __main__:evaluate_policy:64 - "


def written(script: Script, actions: list[list[float]], offsets: list[str], result: str, *totals: str) -> str:
    """A log in which every test has the same actions, at most one of them for tests of an offset."""

    def messages() -> Iterator[str]:
        yield "#KEY: a-key-by-mail"
        yield f"\n-----------Parameters-----------------\n{'sim_time_step':>30}: 0.033\n{'-' * 23}End{'-' * 23}\n"
        yield str(script.environment)
        for number, start in enumerate(script.starts(), start=1):
            yield f"#### Test No. {number} ####"
            if script.logs_offsets:
                yield f"Initial offset: [{' '.join(f'{value:g}.' for value in start.offset)}]"
            for n, action in enumerate(actions, start=1):
                yield f"Step {n} Action: [{' '.join(map(str, action))}]"
                if script.logs_offsets:
                    yield f"Offset: {offsets[number - 1]}"
            yield f"RESULT: {result}"
        yield from totals

    return "\n".join(PREFIX + message for message in messages()) + "\n"


def peg_log(
    result: str = "FAIL", steps: int = 8, totals: tuple[str, ...] = ("#SUCCESS_RATE: 0", "#AVG_STEP: NA")
) -> str:
    offsets = [f"[{' '.join(map(str, start.offset))}]" for start in PEG.starts()]
    return written(PEG, [[0.0, 0.0, 0.0]] * steps, offsets, result, *totals)


def read(text: str) -> TextLog:
    return read_text_log(io.BytesIO(text.encode()))


def problems(text: str) -> tuple[str, ...]:
    return summarize(read(text))[1].problems


def test_whole_log_of_pegs_is_read_without_a_problem_and_is_of_our_task() -> None:
    script, summary = summarize(read(peg_log()))
    assert script == PEG
    assert (summary.problems, summary.episodes, summary.team) == ((), 180, "a-key-by-mail")
    assert track_and_task_names(script) == ("vitac_2024", "peg-insertion-2024")
    task = load_track("vitac_2024").tasks["peg-insertion-2024"]
    assert explain_not_resimulated(read(peg_log()), script, task) is None
    recordings = list(text_log_recordings(read(peg_log()), script, task))
    assert [recording.episode.shape for recording in recordings[::60]] == ["cuboid", "trapezoid", "concave1"]


def test_whole_log_of_locks_has_no_offsets_and_is_of_our_task() -> None:
    text = written(LOCK, [[0.5, 0.0, -1.0]] * 100, [], "FAIL", "#SUCCESS_RATE: 0", "#AVG_STEP: NA")
    script, summary = summarize(read(text))
    assert (script, summary.problems, summary.episodes) == (LOCK, (), 160)
    task = load_track("vitac_2024").tasks["lock-opening-2024"]
    recordings = list(text_log_recordings(read(text), script, task))
    assert (recordings[159].episode.shape, recordings[159].episode.offset) == ("key4", (9.5, 0.0, 0.0))
    assert recordings[0].actions.shape == (100, 3)


def test_rates_are_printed_in_percent_or_as_a_fraction() -> None:
    assert problems(peg_log("SUCCESS", 8, ("#SUCCESS_RATE: 1.0000", "#AVG_STEP: 8.00"))) == ()
    assert problems(peg_log("SUCCESS", 8, ("#SUCCESS_RATE: 100.00%", "#AVG_STEP: 8.00"))) == ()
    assert problems(peg_log("SUCCESS", 8, ("#SUCCESS_RATE: 0.5000", "#AVG_STEP: 8.00"))) == (
        "the success rate is 100.00 %, the log claims 50.00 %",
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (peg_log(steps=5), "test 1: env step 5 is the last, but did not end the test"),
        (peg_log("SUCCESS", 2), "test 1: RESULT says SUCCESS, which its last env step cannot be"),
        (peg_log(steps=9), "test 1: expected at most 8 env steps, got 9"),
        (peg_log().replace("Step 1 Action: [0.0", "Step 1 Action: [0.5", 1), "test 1: env step 1: the action does not"),
        (peg_log().replace("'max_steps': 8", "'max_steps': 9"), "environment: expected the official max_steps = 8"),
    ],
)
def test_what_the_rules_of_2024_forbid_is_named(text: str, problem: str) -> None:
    assert any(found.startswith(problem) for found in problems(text)), problems(text)[:3]


def test_same_settings_with_an_md5_are_track_3_of_2025() -> None:
    assert find_script(PEG.environment, has_md5=False) == PEG
    track_3 = find_script(PEG.environment)
    assert track_3 is not None
    assert track_3.track == "Track_3"


def test_a_test_is_resimulated_to_where_its_actions_lead(tmp_path: Path) -> None:
    (tmp_path / "run.log").write_text(peg_log())
    task = load_track("vitac_2024").tasks["peg-insertion-2024"]
    recording = next(read_recordings(tmp_path / "run.log", task))
    played = resimulate(make_environment(task, None, ()), recording.episode, recording.actions)
    assert played.infos[-1]["gt_offset_mm_deg"] == [-4, -4, -8]
    assert (played.outcome, played.end_step) == ("steps", 8)
