"""`vitac station`: the devices of a laboratory."""

import json
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from .terminal.output import AsJson, print_json, print_table

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
    found = list(check_station(description))
    if as_json:
        print_json({"station": description.name, "devices": [asdict(each) for each in found]})
    else:
        rows = [(each.device, "refused" if each.problems else "ok") for each in found]
        print_table(("device", "state"), rows, none="")
        for each in found:
            for problem in each.problems:
                print(f"{each.device}, {problem.rule}: {problem.sentence}")
    if any(each.problems for each in found):
        raise typer.Exit(1)


@app.command("twin")
def twin(file: Annotated[Path, typer.Argument(help="Where to write the description of the twins (YAML).")]) -> None:
    """Run twins of all devices but the RGB-D camera, which send the same bytes, until Ctrl-C."""
    from signal import pause

    from vitac.station.twin.laboratory import twin_station

    if file.exists():
        raise typer.BadParameter(f"{file} exists; name a new file.")
    with twin_station() as station:
        station.write(file)
        print(f"{file} describes the twins. They run until Ctrl-C; check them with: vitac station check {file}")
        pause()


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
    from vitac.station.ros.messages import RosVersion
    from vitac.station.ros.readings import Side
    from vitac.station.ros.relay import listen, summarize

    side = Side(reset) if reset else None
    for topic, fields in islice(listen(RosVersion(ros), side), messages):
        summary = summarize(fields)
        print(json.dumps({"topic": topic, **summary}) if as_json else f"{topic:<22} {_line(summary)}", flush=True)


def _line(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())
