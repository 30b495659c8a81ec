import gzip
import io
import json
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from evaluation_records import make_manifest, make_record
from text_log_writer import text_log
from vitac.evaluator.logs.log import MAX_LINE_BYTES, LogHeader, LogRejected, write_log
from vitac.evaluator.logs.recordings import Recording, RecordingRejected, make_recording
from vitac.evaluator.logs.resimulation import read_recordings
from vitac.evaluator.logs.text_2025 import TextLogRejected, read_text_log, summarize, to_json_lines
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.tracks import find_task

_, TASK = find_task("peg-insertion")
SENSOR_TASK = find_task("sensor-design")[1]
VISION = next(script for script in all_scripts() if script.hole_tops_mm)
PEG, SENSOR = (
    next(script for script in all_scripts() if (script.track, script.task) == (track, "peg_insertion"))
    for track in ("Track_1", "Track_3")
)

LINE = {
    "episode": 4,
    "task": "peg_insertion",
    "shape": "trapezoid",
    "initial_offset": [-4.0, -2.0, 2.0],
    "steps": [
        {"n": 1, "action": [0.1, -0.2, 0.3], "surface_diff_m": [0.001, 0.002], "peg_relative_z_mm": [1, 2, 3, 4]},
        {"n": 2, "action": [1.0, 1.0, -1.0]},
    ],
    "result": "SUCCESS",
    "wall_s": 0.7,
}


def read(path: Path, *lines: Any) -> list[Recording]:
    path.write_text("".join(line if isinstance(line, str) else json.dumps(line) + "\n" for line in lines))
    return list(read_recordings(path, TASK))


def test_reads_a_2025_line(tmp_path: Path) -> None:
    recording = read(tmp_path / "log.jsonl", LINE, {**LINE, "episode": 5, "result": "FAIL"})[0]
    assert (recording.episode.number, recording.episode.shape, recording.episode.offset) == (
        4,
        "trapezoid",
        (-4, -2, 2),
    )
    assert recording.episode.options["rng_seed"] == (0, 4)
    assert recording.actions.dtype == np.float32
    assert recording.actions.tolist() == np.array([[0.1, -0.2, 0.3], [1, 1, -1]], np.float32).tolist()
    assert [len(info) for info in recording.infos] == [2, 0]
    assert recording.infos[0]["surface_diff_m"] == [0.001, 0.002]
    assert recording.success


@pytest.mark.parametrize("result", ["FAIL", "TIME_OUT"])
def test_other_results_of_2025_are_no_success(tmp_path: Path, result: str) -> None:
    assert not read(tmp_path / "log.jsonl", {**LINE, "result": result})[0].success


def test_reads_the_organizers_log(reference_dir: Path) -> None:
    recordings = list(read_recordings(reference_dir / "logs" / "track1_peg_insertion.repeat0.jsonl", TASK))
    assert [recording.episode.number for recording in recordings] == list(range(1, 91))
    assert [(r.episode.shape, r.episode.offset) for r in recordings] == [
        (episode.shape, episode.offset) for episode in TASK.episodes[:90]
    ]


def test_reads_our_own_log(tmp_path: Path) -> None:
    log, record = tmp_path / "log.jsonl", make_record(7)
    with log.open("wb") as stream:
        write_log(stream, LogHeader(manifest=make_manifest()), [record])
    recording = next(iter(read_recordings(log, TASK)))
    assert recording.episode.number == 7
    assert recording.actions.tobytes() == record.actions.to_array().tobytes()
    assert recording.infos == record.infos


def test_reads_bare_records_of_ours(tmp_path: Path) -> None:
    record = make_record(7)
    recording = read(tmp_path / "records.jsonl", record.model_dump(mode="json"))[0]
    assert (recording.episode.number, recording.success) == (7, True)
    assert recording.actions.tobytes() == record.actions.to_array().tobytes()


def test_damaged_log_of_ours_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    with log.open("wb") as stream:
        write_log(stream, LogHeader(manifest=make_manifest()), [make_record(7)])
    log.write_bytes(log.read_bytes()[:-20])
    with pytest.raises(LogRejected, match="Line 3"):
        list(read_recordings(log, TASK))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("\x00junk\n", "Line 2 is not JSON"),
        ("[" * 100_000 + "\n", "Line 2 is not JSON"),
        ('{"a": ' + " " * (1 << 20) + "1}\n", "Line 2 is not JSON"),
        ("[]\n", "Line 2"),
        ({**LINE, "task": "juggling"}, "Line 2 is of task 'juggling'"),
        ({"state_hashes": []}, "Line 2: Missing key 'episode'"),
        ({**LINE, "initial_offset": [1, 2]}, "expected a start with one of cuboid, trapezoid, concave1 and 3 numbers"),
        ({**LINE, "initial_offset": [1, 2, 3, 4]}, "expected a start with one of"),
        ({**LINE, "steps": [{"action": [1, 2, 3, 4]}]}, "Line 2: expected actions"),
        ({**LINE, "initial_offset": [1, 2, float("nan")]}, r"Line 2: initial_offset\.2"),
        ({**LINE, "steps": [{"action": [1, 2, 1e40]}]}, "Line 2: expected actions"),
        ({**LINE, "steps": [{"action": [1, 2, 3]}, {"action": [1, 2]}]}, "Line 2: expected actions"),
        ({**LINE, "steps": [{"action": [1, 2, float("nan")]}]}, r"Line 2: steps\.0\.action\.2"),
        ({key: value for key, value in LINE.items() if key != "shape"}, "Line 2: Missing key 'shape'"),
    ],
)
def test_unusable_line_is_named(tmp_path: Path, line: object, message: str) -> None:
    with pytest.raises(RecordingRejected, match=message):
        read(tmp_path / "log.jsonl", LINE, line)


def read_recordings_of(*lines: str) -> list[Recording]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.jsonl"
        path.write_text("".join(lines))
        return list(read_recordings(path, TASK))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ({**LINE, "task": "open_lock"}, "Line 1 is of task 'open_lock', expected 'peg-insertion'."),
        (
            {**LINE, "shape": "key1"},
            "Line 1: expected a start with one of cuboid, trapezoid, concave1 and 3 numbers, "
            "got 'key1' at (-4.0, -2.0, 2.0).",
        ),
        (
            {**LINE, "steps": [{"action": [1, 2]}]},
            "Line 1: expected actions [x, y, theta] in the range of float32.",
        ),
        ({**LINE, "episode": 0}, "Line 1: episode: Input should be greater than 0 (got: 0)."),
        (make_record(2, task="lock-opening").model_dump(mode="json"), None),
    ],
)
def test_what_is_unusable_is_told_in_one_sentence(line: dict[str, Any], message: str | None) -> None:
    with pytest.raises(RecordingRejected) as refused:
        read_recordings_of(json.dumps(line))
    assert str(refused.value) == (message or "Episode 2 is of task 'lock-opening', expected 'peg-insertion'.")


@pytest.mark.parametrize("sign", [1, -1])
def test_actions_reach_to_the_largest_float32_on_either_side(sign: int) -> None:
    largest = float(np.finfo(np.float32).max)
    line = {**LINE, "steps": [{"action": [0, 0, sign * largest]}]}
    assert read_recordings_of(json.dumps(line))[0].actions[0, 2] == np.float32(sign * largest)
    beyond = {**LINE, "steps": [{"action": [0, 0, sign * np.nextafter(largest, np.inf)]}]}
    with pytest.raises(RecordingRejected, match="in the range of float32"):
        read_recordings_of(json.dumps(beyond))


def test_an_episode_without_env_steps_has_actions_of_the_right_size() -> None:
    recording = read_recordings_of(json.dumps({**LINE, "steps": []}))[0]
    assert recording.actions.shape == (0, 3)
    assert recording.infos == ()


def test_keys_that_nobody_needs_are_ignored() -> None:
    assert read_recordings_of(json.dumps({**LINE, "reset_s": 1.5, "choose_left": 0}))[0].episode.number == 4


def test_an_empty_file_has_no_recordings() -> None:
    assert read_recordings_of() == []


def test_a_recorded_episode_has_the_seed_of_its_list_at_the_start_that_was_recorded() -> None:
    episode = make_recording(make_record(4, initial_offset=(9.0, 8.0, 7.0)), TASK).episode
    listed = TASK.episodes[3]
    assert (episode.number, episode.offset) == (4, (9.0, 8.0, 7.0))
    assert (episode.offset_option, episode.list_seed) == (listed.offset_option, listed.list_seed)


@pytest.mark.parametrize("top_mm", VISION.hole_tops_mm)
def test_a_line_of_the_vision_track_starts_where_the_peg_really_was(top_mm: float) -> None:
    """The converted line shows the start as the log did: relative to the hole, in the books of its era."""
    for start in VISION.starts(top_mm)[:6]:
        line = {**LINE, "task": "peg_insertion_v2", "shape": start.shape, "initial_offset": start.offset, "steps": []}
        (recording,) = read_fusion(line)
        assert (recording.episode.shape, recording.episode.offset) == (start.part, start.true_offset)


def test_a_line_of_the_vision_track_may_start_as_our_environment_counts() -> None:
    start = VISION.starts()[0]
    line = {**LINE, "task": "peg_insertion_v2", "shape": start.part, "initial_offset": start.true_offset, "steps": []}
    (recording,) = read_fusion(line)
    assert (recording.episode.shape, recording.episode.offset) == (start.part, start.true_offset)


def read_fusion(line: dict[str, Any]) -> list[Recording]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.jsonl"
        path.write_text(json.dumps(line))
        return list(read_recordings(path, find_task("fusion-insertion")[1]))


def test_a_line_may_be_as_long_as_the_limit_and_no_longer() -> None:
    text = json.dumps(LINE)
    full = text[:-1] + " " * (MAX_LINE_BYTES - len(text)) + "}\n"
    assert len(full.rstrip("\n")) == MAX_LINE_BYTES
    assert [recording.episode.number for recording in read_recordings_of(full, text)] == [4, 4]
    with pytest.raises(RecordingRejected, match=r"^Line 2 is not JSON: "):
        read_recordings_of(text + "\n", full.replace("}\n", "  }\n"))


def test_the_start_of_a_peg_line_is_taken_as_it_was_printed() -> None:
    """Only the vision track shows starts relative to the hole."""
    offset = [-4.000001, -2.0, 2.0]
    (recording,) = read_recordings_of(json.dumps({**LINE, "initial_offset": offset}))
    assert recording.episode.offset == tuple(offset)


INFO: dict[str, Any] = {
    "info_steps": 1,
    "surface_diff_m": [0.0005, 0.00075],
    "tactile_movement_too_large": False,
    "too_many_steps": False,
    "error_too_large": False,
    "peg_relative_z_mm": [0.5, -0.25, 0.125, 1.0],
    "is_success": False,
    "relative_motion_mm_deg": [0.0, 0.5, 0.25, -0.125],
    "gt_offset_mm_deg": [1.0, 2.0, 3.0],
    "offset_obs": [1.0, 2.0, 3.0],
    "reward": -0.5,
}


def written(path: Path, *numbers: int, script: Any = SENSOR, **changes: Any) -> Path:
    """A 2025 text log of these tests, each of two env steps."""
    starts = script.starts()
    tests = [
        {
            "episode": number,
            "initial_offset": starts[number - 1].offset,
            "steps": [{"n": n, "action": [0.5, -0.25, n / 4], **INFO} for n in (1, 2)],
            "result": "SUCCESS" if number % 2 else "FAIL",
            **changes,
        }
        for number in numbers
    ]
    path.write_text(text_log(tests, script.environment, script.md5[0]))
    return path


@pytest.mark.parametrize(("script", "task"), [(PEG, TASK), (SENSOR, SENSOR_TASK)])
def test_reads_a_text_log_as_the_script_wrote_it(script: Any, task: Any, tmp_path: Path) -> None:
    recordings = list(read_recordings(written(tmp_path / "run.log", 1, 2, 3, script=script), task))
    assert [(it.episode.number, it.episode.shape, it.success) for it in recordings] == [
        (1, "cuboid", True),
        (2, "trapezoid", False),
        (3, "concave1", True),
    ]
    assert recordings[0].episode.offset == (-4.0, -4.0, -8.0)
    assert recordings[2].actions.tolist() == [[0.5, -0.25, 0.25], [0.5, -0.25, 0.5]]
    assert [info["surface_diff_m"] for info in recordings[1].infos] == [[0.0005, 0.00075]] * 2
    assert recordings[1].infos[0]["peg_relative_z_mm"] == [0.5, -0.25, 0.125, 1.0]


def test_a_text_log_may_be_gzipped_and_begin_with_blanks(tmp_path: Path) -> None:
    """The organizers' own log of Track 1 begins with three blanks."""
    plain = written(tmp_path / "run.log", 1)
    packed = tmp_path / "run.log.gz"
    packed.write_bytes(gzip.compress(b"   " + plain.read_bytes()))
    assert [it.episode for it in read_recordings(packed, SENSOR_TASK)] == [
        it.episode for it in read_recordings(plain, SENSOR_TASK)
    ]


def test_a_test_that_a_text_log_lacks_changes_no_start_of_the_others(tmp_path: Path) -> None:
    recordings = list(read_recordings(written(tmp_path / "run.log", 1, 3, 7, 271 - 1), SENSOR_TASK))
    starts = SENSOR.starts()
    assert [(it.episode.number, it.episode.shape, it.episode.offset) for it in recordings] == [
        (number, starts[number - 1].shape, starts[number - 1].offset) for number in (1, 3, 7, 270)
    ]


def test_the_organizers_text_log_gives_what_its_converted_lines_give(reference_dir: Path) -> None:
    logs = reference_dir / "logs"
    written_by_them = list(read_recordings(logs / "track1_peg_insertion.first90.log", TASK))
    converted = list(read_recordings(logs / "track1_peg_insertion.repeat0.jsonl", TASK))
    assert len(written_by_them) == 90
    for ours, theirs in zip(written_by_them, converted, strict=True):
        assert (ours.episode, ours.success, ours.infos) == (theirs.episode, theirs.success, theirs.infos)
        assert ours.actions.tobytes() == theirs.actions.tobytes()


def test_text_log_of_another_task_or_with_other_actions_is_refused_by_its_test(tmp_path: Path) -> None:
    log = written(tmp_path / "run.log", 1)
    with pytest.raises(RecordingRejected, match=r"^Test 1 is of task 'peg_insertion', expected 'lock-opening'"):
        list(read_recordings(log, find_task("lock-opening")[1]))
    two = written(tmp_path / "two.log", 2, steps=[{"n": 1, **INFO, "action": [0.5, 0.5]}])
    with pytest.raises(RecordingRejected, match=r"^Test 2: expected actions \[x, y, theta\]"):
        list(read_recordings(two, SENSOR_TASK))
    text = log.read_text()
    log.write_text(re.sub(r"array\(\[0\.0005[^)]*\)", "'much'", text))
    with pytest.raises(RecordingRejected, match=r"^Test 1: steps\.0\.surface_diff_m"):
        list(read_recordings(log, SENSOR_TASK))
    log.write_text(text.replace("Action: [ 0.5", "Action: [ nan"))
    with pytest.raises(TextLogRejected, match="expected a finite number, got 'nan'"):
        list(read_recordings(log, SENSOR_TASK))
    log.write_text(text.splitlines()[0])
    with pytest.raises(TextLogRejected, match="one of them is missing"):
        list(read_recordings(log, SENSOR_TASK))


def test_the_problems_of_a_text_log_are_told_before_its_recordings(tmp_path: Path) -> None:
    told: list[int] = []
    twice = read_recordings(written(tmp_path / "run.log", 1, 2, 2), SENSOR_TASK, on_problems=told.append)
    assert next(twice).episode.number == 1
    (count,) = told
    script, summary = summarize(read_text_log(io.BytesIO((tmp_path / "run.log").read_bytes())))
    assert script == SENSOR
    assert count == len(summary.problems)
    assert any("test 2 is repeated" in problem for problem in summary.problems)


def test_a_text_log_without_a_test_of_the_list_is_refused(tmp_path: Path) -> None:
    log = written(tmp_path / "run.log", 1, 2)
    log.write_text(log.read_text().replace("Test No. 1 ", "Test No. 0 ").replace("Test No. 2 ", "Test No. 99999 "))
    with pytest.raises(TextLogRejected, match=r"^Expected tests 1 to 270 of the list, got 0, 99999\.$"):
        list(read_recordings(log, SENSOR_TASK))
    with pytest.raises(TextLogRejected, match=r"of the list, got none\.$"):
        list(read_recordings(written(log), SENSOR_TASK))


def test_a_text_log_that_was_cut_off_does_not_say_how_its_last_test_ended(tmp_path: Path) -> None:
    log = written(tmp_path / "run.log", 1, 2, 3)
    text = log.read_text()
    log.write_text(text[: text.rindex("\n", 0, text.rindex("RESULT")) + 1])
    assert [(it.success, len(it.actions)) for it in read_recordings(log, SENSOR_TASK)] == [
        (True, 2),
        (False, 2),
        (None, 2),
    ]
    converted = to_json_lines(read_text_log(io.BytesIO(log.read_bytes())), SENSOR)
    lines = log.with_suffix(".jsonl")
    lines.write_text("".join(json.dumps(line) + "\n" for line in converted))
    assert [it.success for it in read_recordings(lines, SENSOR_TASK)] == [True, False, None]
