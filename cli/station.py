"""`vitac station`: the devices of a laboratory."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .terminal.output import AsJson, print_json, print_table

app = typer.Typer(no_args_is_help=True)


@app.callback()
def station() -> None:
    """Check the devices of a laboratory, or twins in their place."""


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
