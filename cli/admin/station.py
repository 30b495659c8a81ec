"""`vitac admin station`: laboratories whose agents play trials."""

from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.principals import CONSOLE
from vitac.server.stations import stations

from .verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

StationName = Annotated[str, typer.Argument(help="Name of the station.")]


@change(app, unknown=("key",))
def add(session: Session, name: StationName) -> dict[str, object]:
    """Add a station and print its key, which is shown once: `vitac station run` needs it."""
    return {"name": name, "key": stations.add_station(session, CONSOLE, name)}


@list_records(app, "name", "worker_id", "created_at", none="No station; `vitac admin station add` adds one.")
def list_stations(session: Session) -> list[dict[str, object]]:
    """List the stations, with the agent that used the key of each last."""
    return [
        {"name": each.name, "worker_id": each.worker_id, "created_at": each.created_at}
        for each in stations.list_stations(session)
    ]


@change(app, question="Remove the station {name}? Its key is refused afterwards.", done="station {name} is removed")
def remove(session: Session, name: StationName) -> dict[str, object]:
    """Remove a station; its agent is refused when it starts next."""
    stations.remove_station(session, CONSOLE, name)
    return {"name": name}
