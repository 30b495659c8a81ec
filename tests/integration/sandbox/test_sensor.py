"""The sandbox in which sensors are made: what it gives, and what it takes from whoever breaks the reader."""

import socket
from dataclasses import replace
from pathlib import Path

import drawn_gels
import pytest
from own_sensors import hollow, msh, write_sensor
from vitac import evaluator
from vitac.cli.check import check
from vitac.evaluator.sensors.check import accepted_sensor
from vitac.evaluator.sensors.made import made_sensor
from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.submission import sensor as sandboxed
from vitac.evaluator.submission.sensor import LIMITS, SensorNotMade, make_sensor


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "Track_3"
    path.mkdir(mode=0o755)
    return path


def test_sensor_is_the_one_that_is_made_outside(folder: Path) -> None:
    write_sensor(folder, drawn_gels.dome())
    assert make_sensor(folder) == made_sensor(accepted_sensor(folder))


def test_own_mesh_is_taken(folder: Path) -> None:
    gel, mesh = hollow()
    points = "markers: {points_mm: [[8, 5], [-8, -5]]}"
    made = make_sensor(write_sensor(folder, gel, points, msh(mesh)))
    assert made.facts.is_own_mesh
    assert made.facts.markers == 2


def test_refusal_comes_out_with_its_rule(folder: Path) -> None:
    with pytest.raises(SensorRejected, match=r"thickness: 9\.000 mm, expected 2 to 8 mm"):
        make_sensor(write_sensor(folder, drawn_gels.flat(9.0)))


def test_what_takes_too_long_is_refused(folder: Path) -> None:
    with pytest.raises(SensorRejected, match=r"took longer than 0\.01 s"):
        make_sensor(write_sensor(folder, drawn_gels.flat()), wall_s=0.01)


def test_what_takes_too_much_memory_is_refused(folder: Path) -> None:
    little = replace(LIMITS, address_space_bytes=200 * 2**20)
    with pytest.raises((SensorRejected, SensorNotMade)):
        make_sensor(write_sensor(folder, drawn_gels.flat()), limits=little)


HOSTILE = """
import os, socket, sys
found = []
for path in ("/etc/shadow", "/root", "/home", "/proc/1/environ", {outside!r}):
    try:
        os.listdir(path) if os.path.isdir(path) else open(path).read()
        found.append(path)
    except OSError:
        pass
for path in ("/submission/new", "/opt/vitac/kernels/new", "/opt/vitac/code/vitac/envs/new"):
    try:
        open(path, "w").close()
        found.append(path)
    except OSError:
        pass
try:
    socket.create_connection(("127.0.0.1", {port}), timeout=1)
    found.append("network")
except OSError:
    pass
sys.stderr.write("found " + repr(found))
sys.exit(1)
"""


def test_code_that_took_over_the_reader_reaches_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module that reads is replaced by one that looks around, as whoever breaks it could."""
    secret = tmp_path / "secret"
    secret.write_text("of the service")
    package = tmp_path / "takeover"
    package.mkdir(mode=0o755)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        (package / "look.py").write_text(HOSTILE.format(outside=str(secret), port=port))
        monkeypatch.setattr(sandboxed, "MODULE", "vitac.takeover.look")
        monkeypatch.setattr(evaluator, "__path__", [str(package)])
        with pytest.raises(SensorNotMade, match=r"found \[\]"):
            make_sensor(write_sensor(folder, drawn_gels.flat()))


def package(folder: Path) -> Path:
    write_sensor(folder, drawn_gels.flat())
    (folder / "submission.yaml").write_text("track: track_3\ntasks: [sensor-standard]\nname: flat\n")
    return folder


def test_check_refuses_a_sensor_without_its_document_before_it_plays(folder: Path) -> None:
    findings = check(package(folder))
    assert len(findings.refused) == 1
    assert "Expected one design document" in findings.refused[0]


@pytest.mark.slow
def test_check_plays_a_sensor_with_the_estimator(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (package(folder) / "design.md").write_text("A flat gel.")
    played: list[tuple[str, bool]] = []

    def note(_: Path, __: object, task: str, ___: object, *, sensor: Path | None, **____: object) -> None:
        played.append((task, sensor is not None and (sensor / "gel.stl").is_file()))

    monkeypatch.setattr("vitac.cli.check._check_task", note)
    findings = check(folder)
    assert findings.refused == []
    assert any(text.startswith("the sensor follows every rule: 294 nodes, digest ") for text in findings.passed)
    assert any(text.startswith("under pins its markers' motion is 45% (RMS) off") for text in findings.passed)
    assert "the design document is included: design.md" in findings.passed
    assert played == [("sensor-standard", True)]
