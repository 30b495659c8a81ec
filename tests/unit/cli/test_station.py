import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from twin_station import TwinStation, twin_station
from vitac.cli import main as cli

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def twins() -> Iterator[TwinStation]:
    with twin_station() as station:
        yield station


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `vitac station check`; exit code, output, errors."""

    def run_check(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            cli.main(["station", "check", *map(str, arguments)])
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, *capsys.readouterr()

    return run_check


def test_station_as_described_is_accepted(twins: TwinStation, tmp_path: Path, run: Run) -> None:
    code, output, _ = run(twins.write(tmp_path))
    assert code == 0
    assert [line.split()[-1] for line in output.splitlines()] == ["state", *["ok"] * 5]


def test_problem_is_printed_and_ends_with_1(twins: TwinStation, tmp_path: Path, run: Run) -> None:
    twins.stage.serial_number = "STAGE-2"
    file = twins.write(tmp_path)
    code, output, _ = run(file)
    assert code == 1
    assert "stage, serial number: Expected serial number STAGE-1, got STAGE-2." in output
    code, output, _ = run(file, "--json")
    assert code == 1
    (problems,) = (each["problems"] for each in json.loads(output)["devices"] if each["device"] == "stage")
    assert [each["rule"] for each in problems] == ["serial number"]


def test_port_that_is_not_there_is_said_once(twins: TwinStation, tmp_path: Path, run: Run) -> None:
    twins.lines["gripper"].unplug()
    code, output, errors = run(twins.write(tmp_path))
    assert (code, errors) == (1, "")
    assert "gripper, found: No gripper at /dev/pts/" in output


def test_file_that_describes_no_station_is_refused(tmp_path: Path, run: Run) -> None:
    (tmp_path / "station.yaml").write_text("name: empty\n")
    code, _, errors = run(tmp_path / "station.yaml")
    assert code == 1
    assert "Missing key 'left'" in errors
