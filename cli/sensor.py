"""`vitac sensor`: meshes, checks and draws a team's own sensor (Track 3)."""

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.evaluator.figures.figures import FigureChoice

from .terminal.output import AsJson, Episodes, Workers, print_json, print_record, print_table

if TYPE_CHECKING:
    from vitac.evaluator.evaluation.sensor import SensorReport
    from vitac.evaluator.sensors.check import CheckedSensor
    from vitac.evaluator.sensors.findings import Finding

app = typer.Typer(no_args_is_help=True)

# In the list of each run; `vitac sensor mesh` says what one costs.
_EPISODES = 270
_TASK, _OWN, _STANDARD = "peg-insertion", "sensor-design", "sensor-standard"

Folder = Annotated[Path, typer.Argument(help="Folder with sensor.yaml and gel.stl.", exists=True, file_okay=False)]
FolderOrStl = Annotated[Path, typer.Argument(help="Folder with sensor.yaml and gel.stl, or an STL file.", exists=True)]


@app.command("check")
def check(sensor: FolderOrStl, as_json: AsJson = False) -> None:
    """Check a sensor against every rule; a bare STL gets the default camera and markers."""
    from vitac.evaluator.sensors.check import check_sensor

    from .terminal.compiling import compiling_shown

    with compiling_shown():
        checked = check_sensor(sensor)
    if as_json:
        print_json({"ok": checked.ok, "digest": _digest(checked), "findings": [asdict(it) for it in checked.findings]})
    else:
        _print_findings(checked)
    if not checked.ok:
        raise typer.Exit(1)


class Mesher(StrEnum):
    """Who meshes the gel."""

    OURS = "ours"
    """Our own mesher, or tet.msh: what is scored."""
    FTETWILD = "ftetwild"
    """fTetWild by `pytetwild`, where it is installed: to look at, never scored."""


@app.command("mesh")
def mesh(
    sensor: Folder,
    mesher: Annotated[
        Mesher, typer.Option(help="ours, which the service uses, or ftetwild, which is never scored.")
    ] = Mesher.OURS,
    as_json: AsJson = False,
) -> None:
    """Mesh the gel of a sensor as the service does, and print the result."""
    from vitac.evaluator.figures.starts import continuum_error
    from vitac.evaluator.sensors.check import accepted_sensor
    from vitac.evaluator.sensors.cost import expected_cpu_s

    from .terminal.compiling import compiling_shown

    if mesher is Mesher.FTETWILD:
        _mesh_with_ftetwild(sensor, as_json=as_json)
        return
    with compiling_shown():
        checked = accepted_sensor(sensor)
        assert checked.meshed is not None  # noqa: S101 - of every accepted sensor
        assert checked.design is not None  # noqa: S101
        meshed = checked.meshed
        error = continuum_error(checked.design)
    facts = {
        "digest": meshed.digest,
        "mesh": "tet.msh" if meshed.is_own else "generated",
        "nodes": len(meshed.mesh.nodes_mm),
        "tetrahedra": len(meshed.mesh.corners),
        "volume_mm3": round(meshed.mesh.volume_mm3, 3),
        "volume_error": round(meshed.volume_error, 6),
        "distance_mm": round(meshed.distance_mm, 4),
        "worst_quality": round(float(meshed.mesh.qualities.min()), 4),
        "mesh_error": error,
        "expected_cpu_s": round(expected_cpu_s(len(meshed.mesh.nodes_mm), episodes=_EPISODES)),
    }
    print_record(facts, as_json=as_json)


def _mesh_with_ftetwild(sensor: Path, *, as_json: bool) -> None:
    from vitac.envs.untrusted_file import find_spelling
    from vitac.evaluator.sensors.findings import sensor_limits
    from vitac.evaluator.sensors.ftetwild import mesh_with_ftetwild
    from vitac.evaluator.sensors.package import GEL_NAME

    made = mesh_with_ftetwild(find_spelling(sensor, GEL_NAME), sensor_limits())
    facts = {
        "mesh": "ftetwild: never scored, other nodes on every run",
        "nodes": len(made.nodes_mm),
        "tetrahedra": len(made.corners),
        "volume_mm3": round(made.volume_mm3, 3),
        "worst_quality": round(float(made.qualities.min()), 4),
    }
    print_record(facts, as_json=as_json)


@app.command("show")
def show(
    sensor: Folder,
    out: Annotated[Path, typer.Option(help="FILE.png.")],
    width: Annotated[int, typer.Option(min=600, max=4000, help="Width in pixels.")] = 1600,
) -> None:
    """Draw a sensor: its gel with driven and sensing faces, its markers, and what its camera sees."""
    from vitac.envs.extras import require_extra

    require_extra("show", "matplotlib", "PIL", user="Drawing")
    from vitac.envs.drawing.files import Destination, Frame
    from vitac.envs.drawing.sensor_view import draw_design
    from vitac.evaluator.sensors.check import accepted_sensor

    from .terminal.compiling import compiling_shown

    destination = Destination.from_path(out)
    if destination.format is not destination.format.PNG:
        raise typer.BadParameter("expected FILE.png.", param_hint="--out")
    with compiling_shown():
        checked = accepted_sensor(sensor)
    assert checked.design is not None  # noqa: S101 - of every accepted sensor
    picture = draw_design(checked.design, title=sensor.resolve().name, width_px=width)
    for path in destination.write([Frame(picture=picture, name="sensor")]):
        print(path)


@app.command("evaluate")
def evaluate(
    sensor: Folder,
    policy: Annotated[
        Path | None,
        typer.Option(
            help="Zip or folder of a submission whose policy plays instead of the standard estimator.", exists=True
        ),
    ] = None,
    episodes: Episodes = None,
    workers: Workers = None,
    figures: Annotated[
        FigureChoice,
        typer.Option(help="Figures to measure: all, none, or quick (those that need no episodes)."),
    ] = FigureChoice.ALL,
    json: Annotated[
        Path | None, typer.Option(help="Write scores, digests, sensing gain and figures to this file.")
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Store no shards, and use no stored ones.")] = False,
) -> None:
    """Play the peg task with a sensor: our standard estimator with and without sight of the markers, or a policy.

    With the standard estimator, the sensor's figures are measured, and shown beside those of the reference gel. Its
    finished shards are stored for 30 days, so that the same command continues after an interruption.

    With --figures quick, episodes are played only if --episodes names them.
    """
    if policy is not None:
        _evaluate_policy(sensor, policy, episodes, workers, json)
        return
    if figures is FigureChoice.QUICK and episodes is None:
        _measure_quickly(sensor, json)
        return
    from vitac.evaluator.cores import count_cores
    from vitac.evaluator.evaluation.sensor import evaluate_sensor
    from vitac.evaluator.tracks import find_task

    from .evaluate import EpisodesProgress, parse_episodes
    from .terminal.compiling import compiling_shown
    from .terminal.output import print_figures

    numbers = parse_episodes(episodes)
    with (
        EpisodesProgress(2 * len(numbers or find_task(_STANDARD)[1].episodes)) as progress,
        compiling_shown(progress.bar),
    ):
        result = evaluate_sensor(
            sensor,
            episodes=numbers,
            workers=workers or count_cores(),
            figures=figures,
            keep=None if fresh else _stored_shards_folder(),
            on_episode=progress.advance,
            on_step=progress.describe,
            on_calibration=progress.count,
        )
    report = result.report()
    if json:
        json.write_text(report.model_dump_json(indent=1) + "\n", encoding="utf-8")
    _print_report(report)
    if report.figures is not None:
        print_figures(report.figures)
    for reason in report.not_measured:
        print(reason)


def _measure_quickly(sensor: Path, out: Path | None) -> None:
    from json import dumps

    from vitac.evaluator.evaluation.sensor import measure_quickly

    from .terminal.compiling import compiling_shown
    from .terminal.output import print_figures

    with compiling_shown():
        digest, figures = measure_quickly(sensor)
    if out:
        shown = {"sensor_digest": digest, "figures": figures.model_dump(mode="json"), "figures_digest": figures.digest}
        out.write_text(dumps(shown, indent=1) + "\n", encoding="utf-8")
    print(f"sensor digest {digest}")
    print_figures(figures)
    print("No episode was played; --figures all measures the others, and plays both runs of the standard estimator.")


def _stored_shards_folder() -> Path:
    from vitac.envs.kernel_cache import cache_root

    return cache_root() / "finished-shards-v1"


def _evaluate_policy(sensor: Path, policy: Path, episodes: str | None, workers: int | None, json: Path | None) -> None:
    from vitac.evaluator.submission.sources import read_manifest_file

    from .evaluate import command

    task = _OWN if _OWN in read_manifest_file(policy).tasks else _TASK
    command(policy, task=task, sensor=sensor, episodes=episodes, workers=workers, json=json)


def _print_report(report: "SensorReport") -> None:
    print(f"sensor digest {report.sensor_digest}")
    rows = [(run.task, run.episodes, run.successes, f"{run.success_rate:.1%}") for run in report.runs]
    print_table(("run", "episodes", "successes", "rate"), rows, none="")
    gain = report.gain
    interval = f"{100 * gain.low:+.1f} to {100 * gain.high:+.1f}"
    print(f"sensing gain {100 * gain.gain:+.1f} points, 95 % interval {interval}, exact p {gain.p_value:.2g}")
    print(f"coefficients {report.coefficients_digest}")
    for run in report.runs:
        print(f"result hash of {run.task} {run.result_hash}")


def _digest(checked: "CheckedSensor") -> str | None:
    return None if checked.meshed is None else checked.meshed.digest


def _verdict(finding: "Finding") -> str:
    if not finding.ok:
        return "refused"
    return "warning" if finding.is_warning else "ok"


def _print_findings(checked: "CheckedSensor") -> None:
    rows = [(_verdict(it), str(it.rule), it.value, it.limit) for it in checked.findings]
    print_table(("", "rule", "value", "limit"), rows, none="")
    for finding in checked.findings:
        if finding.is_warning or not finding.ok:
            print(f"{finding.rule}: {finding.problem}")
    print(
        f"The sensor follows all rules. Mesh digest {_digest(checked)}"
        if checked.ok
        else "This sensor would be refused."
    )
