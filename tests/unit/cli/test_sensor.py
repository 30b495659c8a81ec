import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import drawn_gels
import numpy as np
import own_sensors
import pytest
import short_calibration
from PIL import Image
from vitac.cli import main as cli
from vitac.cli import sensor as sensor_command
from vitac.cli.terminal import compiling
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.sensors.check import accepted_sensor, check_sensor
from vitac.evaluator.sensors.findings import sensor_limits
from vitac.evaluator.sensors.made import made_sensor
from vitac.evaluator.shards import host_process

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `vitac sensor`; exit code, output, errors."""

    def run_sensor(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as exit_:
            cli.main(["sensor", *map(str, arguments)])
        assert isinstance(exit_.value.code, int)
        return exit_.value.code, *capsys.readouterr()

    return run_sensor


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sensor that keeps to all rules."""
    (tmp_path / "gel.stl").write_bytes(drawn_gels.stl_bytes(drawn_gels.ridge()))
    (tmp_path / "sensor.yaml").write_text("markers: {grid: {columns: 8, rows: 6, spacing_mm: [2.5, 2]}}\n")
    return tmp_path


def test_check_prints_every_rule_with_value_and_limit(run: Run, folder: Path) -> None:
    code, out, _ = run("check", folder)
    assert code == 0
    assert "ok  thickness" in out
    assert "4.000 mm" in out
    assert "2 to 8 mm" in out
    assert "48 of 48 attached" in out
    assert out.splitlines()[-1].startswith("The sensor follows all rules. Mesh digest ")


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["check", "mesh"])
def test_compiling_is_shown_while_a_sensor_is_checked(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    """The kernels that place markers are compiled in the first command."""

    @contextmanager
    def shown() -> Iterator[None]:
        sys.stderr.write("compiling\n")
        yield

    monkeypatch.setattr(compiling, "compiling_shown", shown)
    assert run(verb, folder)[2] == "compiling\n"


def test_check_of_a_bare_stl_as_json(run: Run, folder: Path) -> None:
    code, out, _ = run("check", folder / "gel.stl", "--json")
    found = json.loads(out)
    assert (code, found["ok"], len(found["digest"])) == (0, True, 64)
    assert {"rule": "bodies", "ok": True, "value": "1", "limit": "1"}.items() <= found["findings"][9].items()


def test_check_of_a_broken_gel_exits_with_1(run: Run, tmp_path: Path) -> None:
    (tmp_path / "gel.stl").write_bytes(drawn_gels.stl_bytes(drawn_gels.flat(9.0)))
    code, out, _ = run("check", tmp_path / "gel.stl")
    assert code == 1
    assert "thickness: Change the gel's height." in out
    assert out.splitlines()[-1] == "This sensor would be refused."
    code, out, _ = run("check", tmp_path / "gel.stl", "--json")
    assert (code, json.loads(out)["ok"]) == (1, False)


def test_mesh_prints_digest_and_figures(run: Run, folder: Path) -> None:
    code, out, _ = run("mesh", folder, "--json")
    figures = json.loads(out)
    assert code == 0
    assert (figures["nodes"], figures["mesh"]) == (351, "generated")
    assert figures["volume_mm3"] == pytest.approx(1351.844)
    assert figures["worst_quality"] > 0.04
    assert figures["digest"] in run("check", folder)[1]
    assert figures["expected_cpu_s"] == 33
    assert 0.1 < figures["mesh_error"] < 1.0
    assert f"digest          {figures['digest']}" in run("mesh", folder)[1]


def test_mesh_of_another_mesher_is_named_and_has_no_digest(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pytetwild", SimpleNamespace(tetrahedralize=one_tetrahedron))
    code, out, _ = run("mesh", folder, "--mesher", "ftetwild", "--json")
    assert code == 0
    assert json.loads(out) == {
        "mesh": "ftetwild: never scored, other nodes on every run",
        "nodes": 4,
        "tetrahedra": 1,
        "volume_mm3": 1.0,
        "worst_quality": 0.181,
    }
    monkeypatch.setitem(sys.modules, "pytetwild", None)
    code, _, err = run("mesh", folder, "--mesher", "ftetwild")
    assert code == 1
    assert "pip install pytetwild" in err


def one_tetrahedron(*_: object, **__: object) -> tuple[object, object]:
    return np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], float), np.array([[0, 1, 2, 3]])


def test_check_warns_of_tips_with_few_nodes_and_accepts_them(run: Run, folder: Path) -> None:
    limits = sensor_limits().model_copy(update={"wanted_tip_nodes": 1})
    meshed = check_sensor(folder, limits).meshed
    assert meshed is not None
    (folder / "tet.msh").write_text(own_sensors.msh(meshed.mesh))
    code, out, _ = run("check", folder)
    assert code == 0
    assert "warning  tips" in out
    assert "tips: A part that touches first has so few nodes that surface_diff depends on the mesh." in out
    findings = json.loads(run("check", folder, "--json")[1])["findings"]
    assert [it["rule"] for it in findings if it["is_warning"]] == ["tips"]


def test_mesh_of_a_broken_gel_names_the_rule(run: Run, folder: Path) -> None:
    (folder / "gel.stl").write_bytes(drawn_gels.stl_bytes(drawn_gels.flat(1.0)))
    code, _, err = run("mesh", folder)
    assert code == 1
    assert err == "vitac: thickness: 1.000 mm, expected 2 to 8 mm. Change the gel's height.\n"


def test_unknown_key_is_refused(run: Run, folder: Path) -> None:
    (folder / "sensor.yaml").write_text("friction: 3\n")
    code, _, err = run("check", folder)
    assert code == 1
    assert "Unknown key 'friction'" in err


def test_show_draws_a_picture(run: Run, folder: Path) -> None:
    code, out, _ = run("show", folder, "--out", folder / "sensor.png", "--width", 900)
    assert (code, out) == (0, f"{folder / 'sensor.png'}\n")
    with Image.open(folder / "sensor.png") as image:
        assert image.size == (900, 300)
        assert len(image.getcolors(2**20) or ()) > 100
    assert run("show", folder, "--out", folder / "sensor.gif")[0] == 2


def test_evaluate_refuses_a_broken_sensor_before_it_plays(run: Run, folder: Path, repository: Path) -> None:
    (folder / "gel.stl").write_bytes(drawn_gels.stl_bytes(drawn_gels.flat(1.0)))
    policy = repository / "examples" / "peg_insertion_heuristic" / "Track_1"
    code, out, err = run("evaluate", folder, "--policy", policy, "--episodes", "1")
    assert (code, out) == (1, "")
    assert err.startswith("vitac: thickness: 1.000 mm, expected 2 to 8 mm.")


@pytest.mark.slow
def test_evaluate_plays_the_estimator_with_and_without_sight_of_the_markers(
    run: Run, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host_process, "COMMAND", short_calibration.COMMAND)
    monkeypatch.setattr(sensor_command, "_stored_shards_folder", lambda: tmp_path / "kept")
    out_file = tmp_path / "report.json"
    command = ("evaluate", folder, "--episodes", "1:2", "--workers", 1, "--json", out_file, "--figures", "quick")
    code, out, err = run(*command)
    assert code == 0
    assert "vitac: meshing the gel\nvitac: calibrating the standard estimator\n" in err
    report = json.loads(out_file.read_text())
    assert [(row["task"], row["episodes"]) for row in report["runs"]] == [("sensor-standard", 2), ("sensor-blind", 2)]
    assert report["gain"]["episodes"] == 2
    made = made_sensor(accepted_sensor(folder))
    assert report["sensor_digest"] == made.digest
    assert f"sensor digest {made.digest}" in out
    assert "sensing gain" in out
    assert report["coefficients_digest"] in out
    figures = SensorFigures.model_validate(report["figures"])
    assert report["figures_digest"] == figures.digest
    assert f"0 starts; digest of the figures {figures.digest}" in out
    assert f"force at the grasp              {figures.grasp.force_n:.4g}" in out
    assert "reference gel" in out
    assert "standard score," not in out
    reasons = ["Information and bounds are not there: no start was measured."]
    reasons.append("The standard score under variations is not there: no start was measured.")
    assert report["not_measured"] == [*reasons, "The CPU time of an episode is not there: no start was measured."]
    assert "\n".join(report["not_measured"]) in out
    # Nothing is played again: the second run would find no process to play in.
    monkeypatch.setattr(host_process, "COMMAND", (sys.executable, "-c", "raise SystemExit(1)"))
    assert run(*command)[:2] == (0, out)
    assert json.loads(out_file.read_text()) == report
    code, _, _ = run(*command, "--fresh")
    assert code == 1
    # Without named episodes there is none to play.
    code, out, _ = run("evaluate", folder, "--figures", "quick", "--json", out_file)
    assert (code, out.splitlines()[-1].startswith("No episode was played;")) == (0, True)
    quick = json.loads(out_file.read_text())
    assert quick == {name: report[name] for name in ("sensor_digest", "figures", "figures_digest")}


def test_evaluate_of_a_broken_sensor_names_the_rule(run: Run, folder: Path) -> None:
    (folder / "gel.stl").write_bytes(drawn_gels.stl_bytes(drawn_gels.flat(1.0)))
    code, out, err = run("evaluate", folder, "--episodes", "1")
    assert (code, out) == (1, "")
    assert "thickness: 1.000 mm, expected 2 to 8 mm." in err


def test_evaluate_refuses_a_policy_that_is_not_there(run: Run, folder: Path) -> None:
    code, _, err = run("evaluate", folder, "--policy", folder / "missing")
    assert code == 2
    assert "missing" in err
