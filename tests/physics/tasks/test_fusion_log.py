"""The organizers' Track 2 log of 2025-01-01 in our physics: every test ends as logged."""

import json
from collections import Counter
from pathlib import Path

import pytest
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.logs.resimulation import read_recordings
from vitac.evaluator.logs.text_2025 import check, find_script, read_text_log, summarize
from vitac.evaluator.logs.text_2025.recordings import explain_not_resimulated, text_log_recordings
from vitac.evaluator.tracks import load_track

TASK = load_track("track_2").tasks["fusion-insertion"]


@pytest.fixture
def log_path(reference_dir: Path) -> Path:
    return reference_dir / "logs" / "track2_peg_insertion_v2.log"


def test_books_reward_and_flags_follow_from_the_numbers_without_exception(log_path: Path) -> None:
    with log_path.open("rb") as stream:
        log = read_text_log(stream)
    script, summary = summarize(log)
    assert check(log, script) == []
    assert summary.problems == ()
    assert sum(len(episode.steps) for episode in log.episodes) == 1209
    assert summary.era == "before 2025-03-14: rim 19.9 mm in the books, 17.4 mm in the geometry"


def test_a_converted_log_has_the_same_starts_and_actions(log_path: Path) -> None:
    with log_path.open("rb") as stream:
        log = read_text_log(stream)
    script = find_script(log.environment)
    assert script is not None
    assert explain_not_resimulated(log, script, TASK) is None
    ours, converted = text_log_recordings(log, script, TASK), read_recordings(log_path.with_suffix(".jsonl"), TASK)
    for one, other in zip(ours, converted, strict=True):
        assert (one.episode, one.actions.tobytes()) == (other.episode, other.actions.tobytes())


@pytest.mark.slow
def test_endings_are_the_logged_ones(log_path: Path) -> None:
    """At least 140 of 150 at the logged step, all others one step earlier; every tactile ending is found, no other."""
    path = log_path.with_suffix(".jsonl")
    logged = [json.loads(line)["steps"][-1] for line in path.read_text().splitlines()]
    env = make_environment(TASK, None, ())
    flags = ("tactile_movement_too_large", "error_too_large")
    steps_away, tactile = Counter[int](), 0
    for recording, last in zip(read_recordings(path, TASK), logged, strict=True):
        played = resimulate(env, recording.episode, recording.actions)
        assert [played.infos[-1][flag] for flag in flags] == [last[flag] for flag in flags]
        assert played.end_step is not None
        steps_away[played.end_step - len(recording.actions)] += 1
        tactile += played.outcome is EpisodeOutcome.TACTILE
    assert tactile == 63
    assert steps_away[0] >= 140
    assert set(steps_away) <= {-1, 0}
