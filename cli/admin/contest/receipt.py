"""`vitac admin receipt`: receipts of final results, for those who check a board."""

from pathlib import Path
from typing import Annotated

import typer

from ...service.database import snapshot, transaction
from ...terminal.output import AsJson, print_record

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command()
def key(as_json: AsJson = False) -> None:
    """Show the public key that signs receipts, how many there are, and the digest of the last one."""
    from dataclasses import asdict

    from vitac.server.receipts.chain import chain_state

    with transaction() as session:
        print_record(asdict(chain_state(session)), as_json=as_json)


@app.command()
def export(
    track: Annotated[str, typer.Argument(help="Whose board.")],
    file: Annotated[Path, typer.Argument(help="New file (zip).")],
    task: Annotated[str | None, typer.Option(help="The board of this task; that of all together without it.")] = None,
    stage: Annotated[str | None, typer.Option(help="Of the competition; the one that opened last without it.")] = None,
    as_json: AsJson = False,
) -> None:
    """Write a board with its receipts and records for `vitac receipt audit`; of a sealed list without records."""
    from vitac.server.results.exporting import export_receipts

    with snapshot() as session:
        made = export_receipts(session, file, track, task=task, stage=stage)
    content = {"file": str(file), "entries": len(made.board.entries), "public_key": made.public_key}
    print_record(content, as_json=as_json)
