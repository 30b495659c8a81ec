"""`vitac station`: the devices of a laboratory."""

import json
import sys
from contextlib import ExitStack
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from uuid import UUID

import typer

from .terminal.output import AsJson, print_json, print_table

_DATABASE_S = 60.0
"""Longest wait for a database that is away when the agent starts."""

if TYPE_CHECKING:
    from vitac.station.twin.grasp import Mounted

MountedShape = Annotated[
    str, typer.Option(help="Peg: cuboid, trapezoid or concave1; or key: key1, key2, key3 or key4.")
]

app = typer.Typer(no_args_is_help=True)


@app.callback()
def station() -> None:
    """Check the devices of a laboratory, or twins in their place; publish what they see."""


@app.command("check")
def check(
    file: Annotated[Path, typer.Argument(help="Description of the station (YAML).", exists=True, dir_okay=False)],
    as_json: AsJson = False,
) -> None:
    """Ask each device of a station whether it is the one that the file describes; move nothing."""
    from vitac.station.check import check_station
    from vitac.station.description import read_description

    description = read_description(file)
    checks = list(check_station(description))
    if as_json:
        print_json({"station": description.name, "devices": [asdict(each) for each in checks]})
    else:
        rows = [(each.device, "refused" if each.problems else "ok") for each in checks]
        print_table(("device", "state"), rows, none="")
        for each in checks:
            for problem in each.problems:
                print(f"{each.device}, {problem.rule}: {problem.sentence}")
    if any(each.problems for each in checks):
        raise typer.Exit(1)


@app.command("twin")
def twin(
    file: Annotated[Path, typer.Argument(help="Where to write the description of the twins (YAML).")],
    secret: Annotated[
        Path | None,
        typer.Option(
            help="File whose content draws what the twin hides: friction, gels, cameras; with `twin: B` in it another "
            "structure, too. Public by default."
        ),
    ] = None,
    identified: Annotated[
        Path | None,
        typer.Option(help="File of `vitac station identify`, in place of a secret: that station's twin."),
    ] = None,
    faults: Annotated[Path | None, typer.Option(help="Script of what breaks, and when (YAML).")] = None,
    shape: MountedShape = "cuboid",
    fusion: Annotated[
        bool,
        typer.Option("--fusion", help="Mount the base with two holes and an RGB-D camera; shape: hexagon or cuboid."),
    ] = False,
    fast: Annotated[
        bool, typer.Option("--fast", help="Take 10 pictures a second instead of 25, and run as fast as it can.")
    ] = False,
) -> None:
    """Run twins of all devices, which behave by our physics, until Ctrl-C or SIGTERM."""
    from vitac.evaluator.strict_model import read_yaml
    from vitac.station.identification.station import IdentifiedStation
    from vitac.station.twin.bench import Bench
    from vitac.station.twin.hidden import PUBLIC_TWIN, FaultScript, read_faults, read_secret
    from vitac.station.twin.laboratory import playing_station

    from .service.stop_request import SUPERVISION_PERIOD_S, StopRequest

    if file.exists():
        raise typer.BadParameter(f"{file} exists; name a new file.")
    if secret and identified:
        raise typer.BadParameter("expected --secret or --identified, got both.", param_hint="--identified")
    drawn = read_secret(secret) if secret else PUBLIC_TWIN
    if identified:
        hidden = read_yaml(IdentifiedStation, identified).settings
        drawn = drawn._replace(hidden=hidden, mark=drawn.mark.model_copy(update={"identified": True}))
    bench = Bench(
        hidden=drawn.hidden,
        mark=drawn.mark,
        script=read_faults(faults) if faults else FaultScript(),
        mounted=_find_mounted(shape, fusion=fusion),
        period_s=0.1 if fast else 0.04,
        speed=None if fast else 1.0,
    )
    with StopRequest().listening() as stop, playing_station(bench) as station:
        station.write(file)
        print(f"{file} describes {drawn.mark}. It runs until Ctrl-C; check them with: vitac station check {file}")
        while not stop.wait(SUPERVISION_PERIOD_S):
            pass


def _find_mounted(shape: str, *, fusion: bool) -> "Mounted":
    from vitac.envs.geometry.keys_and_locks import KeyShape
    from vitac.envs.geometry.pegs import PegShape
    from vitac.station.description import StationTask
    from vitac.station.trials import HOLES_Y_MM
    from vitac.station.twin.grasp import Mounted

    tasks = dict.fromkeys(HOLES_Y_MM, StationTask.FUSION)
    if not fusion:
        tasks = {**dict.fromkeys(PegShape, StationTask.PEG), **dict.fromkeys(KeyShape, StationTask.LOCK)}
    if shape not in tasks:
        raise typer.BadParameter(f"expected one of {', '.join(tasks)}, got {shape!r}.", param_hint="--shape")
    return Mounted(tasks[shape], shape)


@app.command("identify")
def identify(
    file: Annotated[Path, typer.Argument(help="Description of the station (YAML).", exists=True, dir_okay=False)],
    out: Annotated[Path, typer.Option(help="Where to write the settings (YAML); a new file.")],
) -> None:
    """Touch plate and hole, and estimate frictions, gel, cameras and places, with 95 % intervals."""
    import yaml
    from vitac.station.description import StationTask, read_description
    from vitac.station.eyes import find_procedure, open_station
    from vitac.station.identification.station import identify
    from vitac.station.rehearsal import StationRefused, refuse_wrong_devices

    if out.exists():
        raise typer.BadParameter(f"{out} exists; name a new file.", param_hint="--out")
    description = read_description(file)
    mounted = find_procedure(description).task
    if mounted is not StationTask.PEG:
        raise StationRefused(f"Probes need {StationTask.PEG} mounted, got {mounted}.")
    refuse_wrong_devices(description)
    with open_station(description) as station:
        settings = identify(station, lambda sentence: print(sentence, flush=True))
    if settings.twin:
        print(f"{settings.station} is {settings.twin}.")
    rows = [
        (name, f"{each.value:.4g}", f"{each.low:.4g} to {each.high:.4g}", "yes" if each.seen else "no")
        for name, each in settings.estimates.items()
    ]
    print_table(("number", "estimate", "95 % interval", "seen"), rows, none="")
    for sentence in settings.unseen:
        print(f"Probing cannot show {sentence}.")
    out.write_text(yaml.safe_dump(settings.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    print(f"{out} has the settings: take them with `vitac station twin --identified` and as `draws` of environments.")


@app.command("track")
def track(
    shape: MountedShape = "cuboid",
    repeats: Annotated[int, typer.Option(min=1, help="How often every start is played.")] = 5,
    fusion: Annotated[bool, typer.Option("--fusion", help="Of the fusion task; shape: hexagon or cuboid.")] = False,
) -> None:
    """Print a track file for VITAC_TRACKS_DIR: the public starts of a shape, played on stations."""
    import yaml
    from vitac.station.description import make_station_track

    task, mounted = _find_mounted(shape, fusion=fusion)
    content = make_station_track(mounted, repeats, task=task)
    print(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), end="")


@app.command("run")
def run(
    file: Annotated[Path, typer.Argument(help="Description of the station (YAML).", exists=True, dir_okay=False)],
    key_file: Annotated[Path, typer.Option("--key", help="File with the station's key.", exists=True, dir_okay=False)],
    pictures: Annotated[Path | None, typer.Option(help="Write pictures of both gels here.")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the console; 0 for any that is free.")] = 0,
    console: Annotated[
        Path | None,
        typer.Option(help="File for the console's address, which only this user reads; else it is printed."),
    ] = None,
) -> None:
    """Play the trials of the service on a station until Ctrl-C or SIGTERM, which gives the running trial back."""
    from vitac.envs.tasks.definition import Family
    from vitac.server.accounts.stations import enrol
    from vitac.server.services import open_services
    from vitac.server.storage.scratch import scratch_folder
    from vitac.station.agent import StationShards
    from vitac.station.description import read_description
    from vitac.station.held_part import HeldPart
    from vitac.station.rehearsal import refuse_wrong_devices
    from vitac.station.trials import TrialPlayer
    from vitac.worker.live_pictures import LivePictures
    from vitac.worker.main import work

    from .rehearsal import Album, make_operator, no_pictures, serving_console
    from .service.database import load_settings
    from .service.web_server import configure_events

    description = read_description(file)
    settings = load_settings(worker_slots=1)
    configure_events(sys.stderr, settings.log_format)
    key, show = key_file.read_text(encoding="utf-8").strip(), Album(pictures).show if pictures else no_pictures
    names: list[str] = []
    with ExitStack() as stack:
        player = TrialPlayer(
            description=description,
            folder=stack.enter_context(scratch_folder(settings.scratch_dir, "station")),
            operator=make_operator(description),
            attempts=1,
            show=show,
            held=HeldPart.of_station(file),
        )
        stack.enter_context(player)
        address = stack.enter_context(serving_console(player, port))
        services = stack.enter_context(open_services(settings, may_run_database=False))
        _give_address(address, console)
        live = stack.enter_context(LivePictures(services=services, find_station=lambda: names[-1] if names else ""))
        player.share = live.show

        def become_agent(worker_id: UUID) -> str:
            """Take the station's key before the first byte to its devices: another agent may be playing on them."""
            station = services.database.retrying(
                lambda session: enrol(session, settings, key, worker_id, description.twin_words),
                give_up_after_s=_DATABASE_S,
            )
            names.append(station)
            refuse_wrong_devices(description)
            return station

        work(services, StationShards(player).running_shard, families=(Family.STATION,), enrol=become_agent)


def _give_address(address: str, file: Path | None) -> None:
    """Give the console's address to who may operate the station; whoever has it, may."""
    if file is None:
        typer.echo(f"Console: {address}", err=True)
        return
    file.unlink(missing_ok=True)
    file.touch(mode=0o600)
    file.write_text(f"{address}\n", encoding="utf-8")


@app.command("verify")
def verify(
    file: Annotated[Path, typer.Argument(help="Video of a trial.", exists=True, dir_okay=False)],
    log: Annotated[
        Path | None,
        typer.Option(help="Log of the evaluation, whose record is compared.", exists=True, dir_okay=False),
    ] = None,
    episode: Annotated[
        int | None, typer.Option(min=1, help="Which trial of the log it is to be; by default that with its code.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Find a cut, swapped, repeated, delayed or changed frame in the video of a trial."""
    from vitac.envs.extras import require_extra
    from vitac.evaluator.logs.log import LogReader
    from vitac.station.verification import verify_video

    from .rehearsal import STATION_MODULES

    require_extra("station", *STATION_MODULES, user="A video of a trial")
    findings = verify_video(file)
    if log is not None:
        with log.open("rb") as stream:
            records = list(LogReader(stream).records())
        of_trial = [
            each
            for each in records
            if (each.episode == episode if episode else each.video is not None and each.video.code == findings.code)
        ]
        if of_trial:
            findings = verify_video(file, of_trial[0])
        else:
            trial = episode or f"with the code {findings.code}"
            findings.problems.append(f"The log has no trial {trial}: the video is of another one.")
    if as_json:
        print_json(asdict(findings))
    else:
        for problem in findings.problems:
            print(problem)
        seen = {True: "the overview camera saw it", False: "it is not seen as expected", None: "no camera looks at it"}
        print(f"{findings.frames} frames of the trial with code {findings.code}; {seen[findings.shows_code]}.")
        if not findings.problems:
            against = "as the log has it" if log else "each frame follows the one before"
            print(f"Nothing was cut, swapped, repeated, delayed or changed: {against}. Last link: {findings.link}")
    if findings.problems:
        raise typer.Exit(1)


Ros = Annotated[int | None, typer.Option("--ros", min=1, max=2, help="Version of ROS: 1 or 2.")]
Count = Annotated[int | None, typer.Option(min=1, help="End after as many; by default with Ctrl-C.")]


@app.command("publish")
def publish(
    file: Annotated[Path, typer.Argument(help="Description of the station (YAML).", exists=True, dir_okay=False)],
    ros: Ros = None,
    record: Annotated[
        Path | None, typer.Option(help="Record to NAME.bag (ROS 1), or to a new folder NAME (ROS 2, MCAP).")
    ] = None,
    readings: Count = None,
) -> None:
    """Publish markers and pictures of both gels on the challenge's ROS topics, or record them."""
    from vitac.station.description import read_description
    from vitac.station.ros.messages import RosVersion
    from vitac.station.ros.relay import publish

    if ros is None and record is None:
        raise typer.BadParameter("Expected --ros, --record or both.")
    description = read_description(file)
    count = sum(1 for _ in publish(description, RosVersion(ros) if ros else None, record, readings))
    print(f"{count} readings of both gels")


@app.command("listen")
def listen(
    ros: Annotated[int, typer.Option("--ros", min=1, max=2, help="Version of ROS: 1 or 2.")],
    reset: Annotated[
        Literal["left", "right"] | None, typer.Option(help="Let the tracker of this side start again first.")
    ] = None,
    messages: Count = None,
    as_json: AsJson = False,
) -> None:
    """Print what arrives on the challenge's ROS topics, whoever publishes it."""
    from vitac.station.eyes import Finger
    from vitac.station.ros.messages import RosVersion
    from vitac.station.ros.relay import listen, summarize

    side = Finger(reset) if reset else None
    for topic, fields in islice(listen(RosVersion(ros), side), messages):
        summary = summarize(fields)
        print(json.dumps({"topic": topic, **summary}) if as_json else f"{topic:<22} {_line(summary)}", flush=True)


def _line(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())
