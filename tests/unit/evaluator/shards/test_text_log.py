"""Shards of 2025 text logs, with an environment that simulates nothing."""

import io
from pathlib import Path
from typing import Any

import pytest
from evaluation_fakes import FakeEnvironment
from text_log_writer import text_log
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.logs.findings import ImpossibleReason
from vitac.evaluator.logs.text_2025 import read_text_log, summarize
from vitac.evaluator.logs.text_2025.recordings import explain_not_resimulated, text_log_recordings
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.shards.execution import resimulate_text_log
from vitac.evaluator.shards.order import OrderedShard, ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Task, Track, load_track
from vitac.evaluator.tracks.definition import cut

TRACK = load_track("track_1")
SCRIPTS = {script.name: script for script in all_scripts()}
PEG, LOCK = SCRIPTS["track 1 peg insertion"], SCRIPTS["track 1 lock opening"]
FUSION, DESIGN = SCRIPTS["track 2 peg insertion"], SCRIPTS["track 3 peg insertion"]
TASKS = {
    PEG.name: TRACK.tasks["peg-insertion"],
    LOCK.name: TRACK.tasks["lock-opening"],
    FUSION.name: load_track("track_2").tasks["fusion-insertion"],
}


def test_lists_of_2025_are_ours() -> None:
    for script in (PEG, LOCK, FUSION):
        starts = [(start.part, start.listed_offset) for start in script.starts()]
        assert starts == [(episode.shape, episode.offset) for episode in TASKS[script.name].episodes]


def whole_list(script: Any, actions: list[tuple[float, ...]], rim_mm: float | None = None) -> list[dict[str, Any]]:
    """Every test of the list with the same actions and, where the script logs it, its start."""
    steps = [{"n": n, "action": action} for n, action in enumerate(actions, start=1)]
    return [
        {"episode": n, "steps": steps, "result": "FAIL"} | ({"initial_offset": s.offset} if script.logs_offsets else {})
        for n, s in enumerate(script.starts(rim_mm), start=1)
    ]


@pytest.mark.parametrize("rim_mm", [19.9, 17.4])
def test_a_log_of_the_vision_track_is_ours_in_the_books_of_either_era(rim_mm: float) -> None:
    """With a rim that is too high in the books the peg began that much higher above the real one."""
    task = TASKS[FUSION.name]
    tests = whole_list(FUSION, [(0.0, 1.0, 0.0, 0.0)], rim_mm)
    log = read_text_log(io.BytesIO(text_log(tests, FUSION.environment, FUSION.md5[0]).encode()))
    assert explain_not_resimulated(log, FUSION, task) is None
    era = summarize(log)[1].era or ""
    assert era.startswith("since" if rim_mm == 17.4 else "before")
    assert era.endswith(f"2025-03-14: rim {rim_mm} mm in the books, 17.4 mm in the geometry")
    for recording, listed in zip(text_log_recordings(log, FUSION, task), task.episodes, strict=True):
        higher = [got - expected for got, expected in zip(recording.episode.offset, listed.offset, strict=True)]
        assert higher == pytest.approx([0, 0, 0, rim_mm - 17.4, 0])
        assert recording.episode.shape == listed.shape


def test_a_log_of_the_vision_track_that_mixes_eras_is_refused() -> None:
    old, new = (whole_list(FUSION, [(0.0, 1.0, 0.0, 0.0)], rim_mm) for rim_mm in (19.9, 17.4))
    mixed = [*old[:7], *new[7:]]
    log = read_text_log(io.BytesIO(text_log(mixed, FUSION.environment, FUSION.md5[0]).encode()))
    found = explain_not_resimulated(log, FUSION, TASKS[FUSION.name])
    assert found is not None
    assert (found.reason, found.episode) == (ImpossibleReason.OTHER_START, 8)


def written(path: Path, episodes: list[dict[str, Any]], script: Any = PEG) -> Path:
    path.write_text(text_log(episodes, script.environment, script.md5[0]))
    return path


def resimulated(log: Path, shard: int, skip: tuple[int, ...] = ()) -> tuple[ShardResult, list[EpisodeRecord]]:
    records: list[EpisodeRecord] = []
    task = TASKS[PEG.name]
    part = ordered(log, TRACK, task, shard, skip)
    return resimulate_text_log(part, records.append, lambda *_: FakeEnvironment()), records


def ordered(log: Path, track: Track, task: Task, shard: int, skip: tuple[int, ...] = ()) -> OrderedShard:
    order = ShardOrder(
        kind=SubmissionKind.TEXT_LOG, submission=log, track=track.name, task=task.name, shard=shard, skip=skip
    )
    return OrderedShard(order=order, track=track, task=task, shard=cut(task)[shard])


def test_episode_ends_where_our_physics_ends_it(tmp_path: Path) -> None:
    log = written(tmp_path / "log", whole_list(PEG, [(0.5, 0, 0), (1, 0, 0), (0.5, 0, 0)]))
    result, records = resimulated(log, 1, skip=(28,))
    assert (result.end, [record.episode for record in records]) == (ShardEnd.COMPLETE, list(range(29, 55)))
    assert (records[0].outcome, records[0].env_steps) == (EpisodeOutcome.SUCCESS, 2)
    assert records[0].actions.to_array().tolist() == [[0.5, 0, 0], [1, 0, 0]]
    listed = TASKS[PEG.name].episodes[28]
    assert (records[0].shape, records[0].initial_offset) == (listed.shape, listed.offset)


def test_a_log_of_track_3_is_played_with_the_settings_under_which_it_was_made(tmp_path: Path) -> None:
    """Those that models are scored with are the published ones of Track 1."""
    track, asked = load_track("track_3"), []

    def make_env(task: Task, *_: object) -> FakeEnvironment:
        asked.append(task)
        return FakeEnvironment()

    task = track.tasks["sensor-design"]
    log = written(tmp_path / "log", whole_list(DESIGN, [(0.5, 0, 0)]), DESIGN)
    records: list[EpisodeRecord] = []
    assert resimulate_text_log(ordered(log, track, task, 0), records.append, make_env).end is ShardEnd.COMPLETE
    assert asked[0].settings == task.settings | {"gripper_z_mm": 0.0, "indentation_mm": 1.0, "z_step_mm": 0.075}
    assert [(record.shape, record.initial_offset) for record in records] == [
        (episode.shape, episode.offset) for episode in task.episodes[:27]
    ]
    assert load_track("track_1").tasks["peg-insertion"].apply_text_log_settings() is TASKS[PEG.name], "it was scored so"


def test_actions_that_end_before_the_episode_does_are_no_success(tmp_path: Path) -> None:
    _, records = resimulated(written(tmp_path / "log", whole_list(PEG, [(0.5, 0, 0)])), 0)
    assert {(record.outcome, record.env_steps, record.success) for record in records} == {
        (EpisodeOutcome.ACTIONS_ENDED, 1, False)
    }


def test_log_that_changed_in_the_store_is_impossible(tmp_path: Path) -> None:
    result, records = resimulated(written(tmp_path / "log", whole_list(PEG, [(0.5, 0, 0)])[:-1]), 0)
    assert (result.end, records) == (ShardEnd.REFUTED, [])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda tests: tests[4].update(steps=[]), ImpossibleReason.WRONG_ACTION),
        (lambda tests: tests[4].update(steps=[{"n": 1, "action": (0, 0, 0)}]), ImpossibleReason.WRONG_ACTION),
        (lambda tests: tests[4].update(steps=[{"n": 1, "action": (0, -1.5)}]), ImpossibleReason.WRONG_ACTION),
        (lambda tests: tests[4].update(steps=tests[0]["steps"] * 51), ImpossibleReason.TOO_MANY_STEPS),
        (lambda tests: tests[4].update(episode=6), ImpossibleReason.EPISODE_MISSING),
        (lambda tests: tests.append({**tests[0], "episode": 161}), ImpossibleReason.NOT_IN_LIST),
        (lambda tests: tests.pop(), ImpossibleReason.EPISODE_MISSING),
    ],
)
def test_lock_log_that_cannot_be_resimulated_is_named(change: Any, reason: ImpossibleReason) -> None:
    tests = whole_list(LOCK, [(0.5, 0.5)])
    assert explain_not_resimulated(_read(tests), LOCK, TASKS[LOCK.name]) is None
    change(tests)
    found = explain_not_resimulated(_read(tests), LOCK, TASKS[LOCK.name])
    assert found is not None
    assert found.reason is reason


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda test: test.pop("initial_offset"), "Test 5: expected the start (-4.0, -2.0, 2.0), got none"),
        (lambda test: test.update(initial_offset=(1.0,)), "Test 5: expected the start (-4.0, -2.0, 2.0), got (1.0,)"),
        (
            lambda test: test.update(initial_offset=(1.0,) * 900),
            "Test 5: expected the start (-4.0, -2.0, 2.0), got (1.0, 1.0, ",
        ),
    ],
)
def test_peg_log_without_the_start_of_the_list_is_named(change: Any, message: str) -> None:
    tests = whole_list(PEG, [(0.5, 0, 0)])
    assert explain_not_resimulated(_read(tests, PEG), PEG, TASKS[PEG.name]) is None
    change(tests[4])
    found = explain_not_resimulated(_read(tests, PEG), PEG, TASKS[PEG.name])
    assert found is not None
    assert (found.reason, found.episode) == (ImpossibleReason.OTHER_START, 5)
    assert found.message.startswith(message)
    assert len(found.message) < 200


def _read(tests: list[dict[str, Any]], script: Any = LOCK) -> Any:
    readable = [{**test, "steps": test["steps"] or [{"n": 1, "action": ()}]} for test in tests]
    return read_text_log(io.BytesIO(text_log(readable, script.environment, script.md5[0]).encode()))


def test_log_of_another_list_is_named() -> None:
    found = explain_not_resimulated(_read(whole_list(LOCK, [(0.5, 0.5)])), LOCK, TASKS[PEG.name])
    assert found is not None
    assert found.reason is ImpossibleReason.OTHER_EVALUATION


def test_number_beyond_float32_is_out_of_bounds() -> None:
    log = _read(whole_list(LOCK, [(0.5, 0.5)]))
    log.episodes[6].steps[0].action = (0.5, 1e39)
    found = explain_not_resimulated(log, LOCK, TASKS[LOCK.name])
    assert found is not None
    assert found.message == "Test 7 has the action z = inf at env step 1, expected values in [-1, 1]."
