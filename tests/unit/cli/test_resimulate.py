import json
from pathlib import Path

import pytest
from evaluation_fakes import FakeEnvironment
from text_log_writer import text_log
from vitac.cli import main as cli
from vitac.evaluator.episodes import episode
from vitac.evaluator.logs.text_2025.scripts import all_scripts
from vitac.evaluator.tracks import Task

LINE = {
    "episode": 1,
    "task": "peg_insertion",
    "shape": "cuboid",
    "initial_offset": [-4, -4, -8],
    "steps": [
        {"n": 1, "action": [0.5, 0, 0], "surface_diff_m": [0.0006, 0.0009], "peg_relative_z_mm": [0.5, 0.25]},
        {"n": 2, "action": [1, 0, 0], "surface_diff_m": [0.0007, 0.0008], "peg_relative_z_mm": [0.5, 0.25]},
    ],
    "result": "FAIL",
}


@pytest.fixture
def asked_assets(monkeypatch: pytest.MonkeyPatch) -> list[Path | None]:
    """Takes the simulation's place; the asset folders that were asked for."""
    asked: list[Path | None] = []

    def make(_: object, assets_dir: Path | None, __: object) -> FakeEnvironment:
        asked.append(assets_dir)
        return FakeEnvironment()

    monkeypatch.setattr(episode, "make_environment", make)
    monkeypatch.delenv("VITAC_ASSETS_DIR", raising=False)
    return asked


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "recorded.jsonl"
    path.write_text(json.dumps(LINE) + "\n")
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        cli.main(["resimulate", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


def test_prints_ours_beside_the_record(
    recording: Path, asked_assets: list[Path | None], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, recording, "--task", "peg-insertion")
    assert code == 0
    assert out.splitlines() == [
        "Episode 1: cuboid at -4 -4 -8",
        "  env step  1  surface  1.000  2.000 |  0.600  0.900  peg - |  0.500  0.250",
        "  env step  2  surface  1.000  2.000 |  0.700  0.800  peg - |  0.500  0.250",
        "  success at env step 2 | recorded no success after 2 env steps",
        "1 episodes, 1 successes; 10 IPC steps, 125.0 ms of CPU each; solver fake",
    ]


def test_writes_the_report(
    recording: Path, asked_assets: list[Path | None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.json"
    run(capsys, recording, "--task", "peg-insertion", "--json", out)
    content = json.loads(out.read_text())
    assert content["episodes"][0]["end_reason"] == "success"
    assert content["episodes"][0]["steps"][1] == {"n": 2, "surface_diff_mm": [1.0, 2.0], "is_success": True}
    assert content["ipc_steps"] == 10


def test_assets_come_from_the_option_or_the_environment(
    recording: Path,
    asked_assets: list[Path | None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run(capsys, recording, "--task", "peg-insertion")
    monkeypatch.setenv("VITAC_ASSETS_DIR", "/from/environment")
    run(capsys, recording, "--task", "peg-insertion")
    run(capsys, recording, "--task", "peg-insertion", "--assets", "/from/option")
    assert asked_assets == [None, Path("/from/environment"), Path("/from/option")]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "Missing option '--task'"),
        (["--task", "peg"], 1, "There is no task 'peg'; did you mean lift-peg-upright or peg-insertion"),
    ],
)
def test_unknown_task_is_refused(
    recording: Path,
    asked_assets: list[Path | None],
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    message: str,
) -> None:
    refused, _, err = run(capsys, recording, *arguments)
    assert refused == code
    assert message in err


def test_unreadable_recording_is_refused_by_line(
    recording: Path, asked_assets: list[Path | None], capsys: pytest.CaptureFixture[str]
) -> None:
    recording.write_text(recording.read_text() + "junk\n")
    code, _, err = run(capsys, recording, "--task", "peg-insertion")
    assert code == 1
    assert err.startswith("vitac: Line 2 is not JSON")


@pytest.fixture
def asked_settings(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, object]]:
    """Takes the simulation's place; the settings of the tasks that were asked for."""
    asked: list[dict[str, object]] = []

    def make(task: Task, *_: object) -> FakeEnvironment:
        asked.append(dict(task.settings))
        return FakeEnvironment()

    monkeypatch.setattr(episode, "make_environment", make)
    return asked


def test_profile_of_the_track_file_sets_how_it_was_recorded(
    recording: Path, asked_settings: list[dict[str, object]], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, recording, "--task", "sensor-design", "--profile", "challenge-2025-log")
    assert code == 0
    assert asked_settings == [{"gripper_z_mm": 0.0, "indentation_mm": 1.0, "z_step_mm": 0.075}]
    assert out.startswith("Profile challenge-2025-log: gripper_z_mm 0.0, indentation_mm 1.0, z_step_mm 0.075. The org")


def test_text_log_of_2025_is_taken_as_it_is(
    asked_settings: list[dict[str, object]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (script,) = (it for it in all_scripts() if it.track == "Track_3")
    steps = [{"n": n, "action": [0.5, 0, 0]} for n in (1, 2)]
    tests = [{"episode": 1, "initial_offset": [-4, -4, -8], "steps": steps, "result": "FAIL"}]
    log = tmp_path / "peg_insertion.log"
    log.write_text(text_log(tests, script.environment, script.md5[0]))
    code, out, _ = run(capsys, log, "--task", "sensor-design", "--profile", "challenge-2025-log")
    assert code == 0
    assert asked_settings == [{"gripper_z_mm": 0.0, "indentation_mm": 1.0, "z_step_mm": 0.075}]
    assert "Episode 1: cuboid at -4 -4 -8\n" in out
    assert "recorded no success after 2 env steps\n" in out
    said = out.index("problem")
    assert f"see `vitac log import {log}`.\n" in out[said:]
    assert said < out.index("Episode 1")
    log.write_text(log.read_text().replace(log.read_text().splitlines()[-1] + "\n", ""))
    code, out, _ = run(capsys, log, "--task", "sensor-design")
    assert code == 0
    assert "recorded no result after 2 env steps\n" in out


def test_contact_model_replaces_that_of_the_task(
    recording: Path, asked_settings: list[dict[str, object]], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(capsys, recording, "--task", "peg-insertion", "--contact-model", "arena-2")[0] == 0
    assert asked_settings == [{"contact_model": "arena-2"}]


def test_without_a_profile_the_settings_are_those_that_rank(
    recording: Path, asked_settings: list[dict[str, object]], capsys: pytest.CaptureFixture[str]
) -> None:
    run(capsys, recording, "--task", "sensor-design")
    assert asked_settings == [{}]


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("sensor-design", "expected a profile of sensor-design (challenge-2025-log), got 'other'"),
        ("peg-insertion", "expected a profile of peg-insertion (none), got 'other'"),
    ],
)
def test_unknown_profile_is_refused(
    recording: Path,
    asked_settings: list[dict[str, object]],
    capsys: pytest.CaptureFixture[str],
    task: str,
    message: str,
) -> None:
    code, _, err = run(capsys, recording, "--task", task, "--profile", "other")
    assert code == 2
    assert message in " ".join(err.replace("\u2502", " ").split())
    assert asked_settings == []
