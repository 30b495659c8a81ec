import json
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from vitac.cli import main as cli
from vitac.cli.service.stop_request import StopRequest
from vitac.station.twin.laboratory import TwinStation, twin_station

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def twins() -> Iterator[TwinStation]:
    with twin_station(picture_period_s=0.001) as station:
        yield station


def written(twins: TwinStation, folder: Path) -> Path:
    twins.write(folder / "station.yaml")
    return folder / "station.yaml"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `vitac station`; exit code, output, errors."""

    def run_station(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            cli.main(["station", *map(str, arguments)])
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, *capsys.readouterr()

    return run_station


def test_station_as_described_is_accepted(twins: TwinStation, tmp_path: Path, run: Run) -> None:
    code, output, _ = run("check", written(twins, tmp_path))
    assert code == 0
    assert [line.split()[-1] for line in output.splitlines()] == ["state", *["ok"] * 5]


def test_problem_is_printed_and_ends_with_1(twins: TwinStation, tmp_path: Path, run: Run) -> None:
    twins.stage.serial_number = "STAGE-2"
    file = written(twins, tmp_path)
    code, output, _ = run("check", file)
    assert code == 1
    assert "stage, serial number: Expected serial number STAGE-1, got STAGE-2." in output
    code, output, _ = run("check", file, "--json")
    assert code == 1
    (problems,) = (each["problems"] for each in json.loads(output)["devices"] if each["device"] == "stage")
    assert [each["rule"] for each in problems] == ["serial number"]


def test_port_that_is_not_there_is_said_once(twins: TwinStation, tmp_path: Path, run: Run) -> None:
    twins.lines["gripper"].unplug()
    code, output, errors = run("check", written(twins, tmp_path))
    assert (code, errors) == (1, "")
    assert "gripper, found: No gripper at /" in output


def test_file_that_describes_no_station_is_refused(tmp_path: Path, run: Run) -> None:
    (tmp_path / "station.yaml").write_text("name: empty\n")
    code, _, errors = run("check", tmp_path / "station.yaml")
    assert code == 1
    assert "Missing key 'left'" in errors


def test_twins_run_until_they_are_stopped_and_are_accepted(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, checked = tmp_path / "station.yaml", list[tuple[int, str, str]]()

    def stopped_after_a_check(stop: StopRequest, _: float) -> bool:
        if not checked:
            checked.append(run("check", file))
            signal.raise_signal(signal.SIGTERM)
        return stop.received

    monkeypatch.setattr(StopRequest, "wait", stopped_after_a_check)
    code, _, _ = run("twin", file)
    assert code == 0
    assert not Path(yaml.safe_load(file.read_text())["stage"]["port"]).parent.exists()
    ((checked_code, output, _),) = checked
    assert checked_code == 0, output
    code, _, errors = run("twin", file)
    assert code == 2
    assert "exists; name a new file" in errors
