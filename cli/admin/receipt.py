"""`vitac admin receipt`: receipts of final results, for those who check a board."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.competitions.competition import Competition
from vitac.server.decisions.exporting import export_receipts
from vitac.server.receipts.witnesses import list_witness_views
from vitac.server.transparency.log import read_log_state

from ..service.database import load_settings, open_service, transaction
from ..terminal.output import AsJson, moment, print_json, print_record, print_table
from .competition.competition import CompetitionName

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command()
def key(as_json: AsJson = False) -> None:
    """Show the public key that signs the log of receipts, the log's length, root and checkpoint."""
    with transaction() as session:
        print_record(asdict(read_log_state(session)), as_json=as_json)


@app.command()
def witnesses(as_json: AsJson = False) -> None:
    """List the witnesses that the competitions name, and how far each has signed the log."""
    with transaction() as session:
        found = list_witness_views(session)
    if as_json:
        print_json([one.model_dump(mode="json") for one in found])
        return
    rows = [
        [
            one.witness.split("+")[0],
            one.size,
            one.behind,
            f"{one.behind_s:.0f}",
            one.signed_at and moment(one.signed_at),
        ]
        for one in found
    ]
    print_table(
        ["witness", "signed", "behind", "behind_s", "signed last"], rows, none="No competition names witnesses."
    )


@app.command()
def export(
    track: Annotated[str, typer.Argument(help="Track of the board.")],
    file: Annotated[Path, typer.Argument(help="New file (zip).")],
    task: Annotated[str | None, typer.Option(help="The board of this task; by default that of all tasks.")] = None,
    stage: Annotated[str | None, typer.Option(help="Name of the stage; by default the one that opened last.")] = None,
    kind: Annotated[
        Literal["model", "log"], typer.Option(help="Kind of submission on the board; log only with --task.")
    ] = "model",
    competition: CompetitionName = None,
    as_json: AsJson = False,
) -> None:
    """Write a board with receipts, records and teams' sensors for `vitac receipt audit`.

    Records and sensors of a sealed list are left out until its secret is published.
    """
    ranked = SubmissionKind(kind)
    with open_service(load_settings()) as services, services.database.snapshot() as session:
        board = Competition.find(session, competition, track=track).shown_stage(track, stage)
        made = export_receipts(session, services.blobs, file, board, task=task, kind=ranked)
    content = {"file": str(file), "entries": len(made.board.entries), "public_key": made.public_key}
    print_record(content, as_json=as_json)
