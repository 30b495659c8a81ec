"""A station's file: what it must say, and how it is refused."""

import re
from pathlib import Path

import pytest
from vitac.evaluator.strict_model import DocumentRejected, parse_yaml
from vitac.station import lock_trial, trial, trials
from vitac.station.check import check_procedure
from vitac.station.description import StationDescription, StationTask, make_station_track, read_description
from vitac.station.guard import KEY_PULL_MM, KEY_X_RANGE_MM, KEY_Z_RANGE_MM, LARGEST_RADIUS_MM, LARGEST_THETA_DEG
from vitac.station.twin.laboratory import TwinStation


def written(twins: TwinStation, folder: Path) -> Path:
    twins.write(folder / "station.yaml")
    return folder / "station.yaml"


def test_reads_the_file_and_fills_in_what_has_a_default(twins: TwinStation, tmp_path: Path) -> None:
    described = read_description(written(twins, tmp_path))
    assert described.force_torque.rate_hz == 1000
    assert described.limits.marker_movement_px == 30.0
    assert described.depth_camera is None


def test_station_in_the_documentation_can_play(repository: Path) -> None:
    text = (repository / "docs" / "station.md").read_text()
    (devices,) = re.findall(r"```yaml\n(name: .*?)```", text, re.DOTALL)
    (procedure,) = re.findall(r"```yaml\n(procedure:.*?)```", text, re.DOTALL)
    described = parse_yaml(StationDescription, devices + procedure, "docs/station.md")
    assert described.stage.serial_number == "STAGE-1"
    assert described.procedure is not None
    assert list(check_procedure(described.procedure, described.limits)) == []


@pytest.mark.parametrize(
    ("task", "shape", "numbers"),
    [
        (StationTask.PEG, "cuboid", (trial._SUCCESS_DEPTH_MM, LARGEST_RADIUS_MM, LARGEST_THETA_DEG)),
        (StationTask.LOCK, "key1", (lock_trial._LIFTED_MM, KEY_PULL_MM, *KEY_X_RANGE_MM, *KEY_Z_RANGE_MM)),
        (
            StationTask.FUSION,
            "hexagon",
            (trials._DEPTH_MM, *trials._NEAR, *trials._RANGE, -trials._LOWEST_MM, trials._HIGHEST_MM),
        ),
    ],
)
def test_track_of_a_station_says_when_a_trial_succeeds_there(
    task: StationTask, shape: str, numbers: tuple[float, ...]
) -> None:
    (own,) = make_station_track(shape, 2, starts=3, task=task)["tasks"].values()
    said = set(map(float, re.findall(r"-?[0-9]+(?:\.[0-9]+)?", own["success_rule"])))
    assert {*numbers, float(own["max_steps"])} <= said
    assert own["notes"][0] == f"3 starts with the {shape}, 2 times each. They are not observed."


@pytest.mark.parametrize(
    ("keys", "value", "sentence"),
    [
        (("left", "serial"), "x", "Unknown key 'left.serial'; did you mean 'serial_number'?"),
        (("limits", "workspace", "x_mm"), [3, -3], r"x_mm: expected \[lowest, highest\], got \[3.0, -3.0\]"),
        (("limits", "speed_mm_s"), 0, "limits.speed_mm_s: Input should be greater than 0"),
        (("limits", "force_n"), float("nan"), "limits.force_n: Input should be a finite number"),
        (("limits", "gripper", "force"), 256, "limits.gripper.force: Input should be less than or equal to 255"),
        (("stage", "port"), "/dev/ttyUSB0", "stage and gripper are both at /dev/ttyUSB0; expected two serial ports"),
        (("right", "stream"), "http://localhost/", "left and right are both read from http://localhost/; expected two"),
        (("right", "serial_number"), "28F0-GX7F", "left and right are both 28F0-GX7F; expected two tactile sensors"),
    ],
)
def test_refuses_with_a_sentence(
    twins: TwinStation, tmp_path: Path, keys: tuple[str, ...], value: object, sentence: str
) -> None:
    twins.description["gripper"]["port"], twins.description["left"]["stream"] = "/dev/ttyUSB0", "http://localhost/"
    *outer, last = keys
    place = twins.description
    for key in outer:
        place = place[key]
    place[last] = value
    with pytest.raises(DocumentRejected, match=sentence):
        read_description(written(twins, tmp_path))
