"""Options that several commands have, each with its help."""

from pathlib import Path
from typing import Annotated

import typer

Server = Annotated[str | None, typer.Option(help="Address of the service; default: VITAC_SERVER.")]
TokenFile = Annotated[Path | None, typer.Option(help="File with the API token; default: VITAC_TOKEN.")]
Episodes = Annotated[str | None, typer.Option(help="Numbers and ranges, such as 1:12,20; all by default.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Number of processes; one per core by default.")]
Processes = Annotated[int, typer.Option(min=1, help="Processes that play episodes.")]
Ray = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Ray cluster that plays instead, such as 10.0.0.1:6379 or auto.")
]
Assets = Annotated[Path | None, typer.Option(help="Folder with the challenge's own meshes [env: VITAC_ASSETS_DIR].")]
