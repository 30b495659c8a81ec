import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evaluation_records import make_manifest, make_record
from vitac.evaluator.logs.log import LogHeader, LogRejected, write_log
from vitac.evaluator.logs.recordings import Recording, RecordingRejected, read_recordings, recording_of
from vitac.evaluator.tracks import find_task

_, TASK = find_task("peg-insertion")

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
        ({**LINE, "task": "open_lock"}, "Line 2 is of task 'open_lock', expected 'peg-insertion'"),
        ({**LINE, "task": "juggling"}, "Line 2 is of task 'juggling'"),
        ({"state_hashes": []}, "Line 2: Missing key 'episode'"),
        ({**LINE, "shape": "key1"}, "got 'key1' at"),
        ({**LINE, "initial_offset": [1, 2]}, "expected a start with one of cuboid, trapezoid, concave1 and 3 numbers"),
        ({**LINE, "initial_offset": [1, 2, 3, 4]}, "expected a start with one of"),
        ({**LINE, "steps": [{"action": [1, 2, 3, 4]}]}, "Line 2: expected actions"),
        ({**LINE, "initial_offset": [1, 2, float("nan")]}, r"Line 2: initial_offset\.2"),
        ({**LINE, "steps": [{"action": [1, 2]}]}, r"Line 2: expected actions \[x, y, theta\] in the range of float32"),
        ({**LINE, "steps": [{"action": [1, 2, 1e40]}]}, "Line 2: expected actions"),
        ({**LINE, "steps": [{"action": [1, 2, 3]}, {"action": [1, 2]}]}, "Line 2: expected actions"),
        ({**LINE, "steps": [{"action": [1, 2, float("nan")]}]}, r"Line 2: steps\.0\.action\.2"),
        ({key: value for key, value in LINE.items() if key != "shape"}, "Line 2: Missing key 'shape'"),
    ],
)
def test_unusable_line_is_named(tmp_path: Path, line: object, message: str) -> None:
    with pytest.raises(RecordingRejected, match=message):
        read(tmp_path / "log.jsonl", LINE, line)


def test_record_of_another_task_is_refused() -> None:
    with pytest.raises(RecordingRejected, match="Episode 1 is of task 'lock-opening'"):
        recording_of(make_record(task="lock-opening"), TASK)
    with pytest.raises(RecordingRejected, match="Episode 1 is of task 'peg-insertion', expected 'lock-opening'"):
        recording_of(make_record(), find_task("lock-opening")[1])
