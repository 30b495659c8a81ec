"""Why a 2025 text log is none of a whole evaluation of ours, and the recordings of one that is."""

from collections.abc import Callable
from datetime import datetime

import numpy as np
import pytest
from vitac.evaluator.logs.findings import ImpossibleReason
from vitac.evaluator.logs.text_2025 import Script, TextEpisode, TextLog, TextStep
from vitac.evaluator.logs.text_2025.recordings import explain_not_resimulated, text_log_recordings, track_and_task_names
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.tracks import Task, load_track

PEG, LOCK, FUSION, TRACK_3, *_ = all_scripts()
BEGIN = datetime(2025, 1, 1)
Change = Callable[[TextLog], object]


def task_of(script: Script) -> Task:
    track, task = track_and_task_names(script)
    return load_track(track).tasks[task]


def step(n: int, *action: float) -> TextStep:
    return TextStep(line=n, n=n, action=action, started=BEGIN)


def whole(script: Script) -> TextLog:
    """A log with every test of the list, each of one env step."""
    tests = [
        TextEpisode(
            line=number,
            number=number,
            started=BEGIN,
            initial_offset=start.offset if script.logs_offsets else None,
            steps=[step(1, *[0.5] * script.action_size)],
            success=number % 2 == 0,
        )
        for number, start in enumerate(script.starts(), start=1)
    ]
    return TextLog(episodes=tests)


@pytest.mark.parametrize(
    ("script", "names"),
    [
        (PEG, ("track_1", "peg-insertion")),
        (LOCK, ("track_1", "lock-opening")),
        (FUSION, ("track_2", "fusion-insertion")),
    ],
)
def test_a_script_plays_a_task_of_ours(script: Script, names: tuple[str, str]) -> None:
    assert track_and_task_names(script) == names


def test_a_script_of_a_task_that_we_lack_has_names_in_our_form() -> None:
    unknown = PEG.model_copy(update={"track": "Track_9", "task": "open_a_jar"})
    assert track_and_task_names(unknown) == ("track_9", "open-a-jar")
    elsewhere = PEG.model_copy(update={"track": "Track_9"})
    assert track_and_task_names(elsewhere) == ("track_9", "peg-insertion")


@pytest.mark.parametrize("script", [PEG, LOCK, FUSION], ids=lambda script: script.name)
def test_a_whole_log_is_ours(script: Script) -> None:
    assert explain_not_resimulated(whole(script), script, task_of(script)) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"shapes": ("sphere", *PEG.shapes[1:])},
        {"offsets": ((9.0, 9.0, 9.0), *PEG.offsets[1:])},
        {"repeats": PEG.repeats - 1},
    ],
)
def test_another_list_is_not_ours(changes: dict[str, object]) -> None:
    found = explain_not_resimulated(whole(PEG), PEG.model_copy(update=changes), task_of(PEG))
    assert found is not None
    assert (found.reason, found.episode) == (ImpossibleReason.OTHER_EVALUATION, None)
    assert found.message == "The list of peg-insertion is not the published one."


def renumber(log: TextLog) -> None:
    log.episodes[4].number = 6


def elsewhere(log: TextLog) -> None:
    log.episodes[4].initial_offset = (1.0, 2.0, 3.0)


def nowhere(log: TextLog) -> None:
    log.episodes[4].initial_offset = None


def too_long(log: TextLog) -> None:
    log.episodes[4].steps = [step(n, 0, 0, 0) for n in range(1, 10)]


def no_steps(log: TextLog) -> None:
    log.episodes[4].steps = []


def other_size(log: TextLog) -> None:
    log.episodes[4].steps += [step(2, 0.0, 0.0)]


def outside(log: TextLog) -> None:
    log.episodes[4].steps += [step(2, 0.0, -1.5, 0.0)]


def enormous(log: TextLog) -> None:
    log.episodes[4].steps += [step(2, 0.0, 0.0, 1e300)]


FIFTH = PEG.starts()[4].offset
FAULTS: list[tuple[Change, ImpossibleReason, str]] = [
    (renumber, ImpossibleReason.EPISODE_MISSING, "Test 5: expected its number in the log, got 6."),
    (elsewhere, ImpossibleReason.OTHER_START, f"Test 5: expected the start {FIFTH}, got (1.0, 2.0, 3.0)."),
    (nowhere, ImpossibleReason.OTHER_START, f"Test 5: expected the start {FIFTH}, got none."),
    (too_long, ImpossibleReason.TOO_MANY_STEPS, "Test 5 has 9 env steps, expected at most 8."),
    (
        no_steps,
        ImpossibleReason.WRONG_ACTION,
        "Test 5: expected actions [x, y, theta], got none or one of another size.",
    ),
    (
        other_size,
        ImpossibleReason.WRONG_ACTION,
        "Test 5: expected actions [x, y, theta], got none or one of another size.",
    ),
    (
        outside,
        ImpossibleReason.WRONG_ACTION,
        "Test 5 has the action y = -1.5 at env step 2, expected values in [-1, 1].",
    ),
    (
        enormous,
        ImpossibleReason.WRONG_ACTION,
        "Test 5 has the action theta = inf at env step 2, expected values in [-1, 1].",
    ),
]


@pytest.mark.parametrize(("change", "reason", "message"), FAULTS)
def test_the_first_test_that_is_not_ours_is_named(change: Change, reason: ImpossibleReason, message: str) -> None:
    log = whole(PEG)
    log.episodes[7].steps = []
    change(log)
    found = explain_not_resimulated(log, PEG, task_of(PEG))
    assert found is not None
    assert (found.reason, found.episode, found.message) == (reason, 5, message)


def test_a_log_may_use_all_env_steps_and_all_of_the_range_of_an_action() -> None:
    log = whole(PEG)
    log.episodes[4].steps = [step(n, -1, 1, 0) for n in range(1, 9)]
    assert explain_not_resimulated(log, PEG, task_of(PEG)) is None


def test_tests_beyond_the_list_are_not_ours() -> None:
    log = whole(PEG)
    log.episodes.append(TextEpisode(line=1, number=271, started=BEGIN))
    found = explain_not_resimulated(log, PEG, task_of(PEG))
    assert found is not None
    assert (found.reason, found.episode) == (ImpossibleReason.NOT_IN_LIST, 271)
    assert found.message == "Test 271 is not in the list of 270 tests."


@pytest.mark.parametrize("count", [0, 1, 269])
def test_tests_that_are_missing_at_the_end_are_counted(count: int) -> None:
    log = whole(PEG)
    del log.episodes[count:]
    found = explain_not_resimulated(log, PEG, task_of(PEG))
    assert found is not None
    assert (found.reason, found.episode) == (ImpossibleReason.EPISODE_MISSING, count + 1)
    assert found.message == f"Expected 270 tests, got {count}; the first missing one is {count + 1}."


def test_a_lock_log_that_shows_a_start_is_compared_with_it_all_the_same() -> None:
    log = whole(LOCK)
    log.episodes[0].initial_offset = (9.0, 9.0, 9.0)
    found = explain_not_resimulated(log, LOCK, task_of(LOCK))
    assert found is not None
    assert (found.reason, found.episode) == (ImpossibleReason.OTHER_START, 1)


def test_recordings_are_the_lists_episodes_with_the_logs_actions() -> None:
    log, task = whole(PEG), task_of(PEG)
    log.episodes[2].steps = [step(1, 0.1, 0.2, 0.3), step(2, -1.0, 1.0, 0.0)]
    log.episodes[3].success = None
    recordings = list(text_log_recordings(log, PEG, task))
    assert [recording.episode for recording in recordings] == list(task.episodes)
    assert recordings[2].actions.dtype == np.float32
    assert recordings[2].actions.tolist() == np.array([[0.1, 0.2, 0.3], [-1, 1, 0]], np.float32).tolist()
    assert [recording.success for recording in recordings[:4]] == [False, True, False, False]
    assert all(recording.infos == () for recording in recordings)


def test_recordings_of_a_log_that_lacks_tests_are_an_error_of_the_caller() -> None:
    log = whole(PEG)
    del log.episodes[-1]
    with pytest.raises(ValueError, match="longer"):
        list(text_log_recordings(log, PEG, task_of(PEG)))


@pytest.mark.parametrize("top_mm", FUSION.hole_tops_mm)
def test_a_recording_of_the_vision_track_starts_where_the_peg_really_was(top_mm: float) -> None:
    log, starts = whole(FUSION), FUSION.starts(top_mm)
    for episode, start in zip(log.episodes, starts, strict=True):
        episode.initial_offset = start.offset
    recordings = list(text_log_recordings(log, FUSION, task_of(FUSION)))
    assert [recording.episode.offset for recording in recordings] == [start.true_offset for start in starts]
    assert [recording.episode.shape for recording in recordings] == [start.part for start in starts]
