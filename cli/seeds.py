"""`vitac seeds`: makes and verifies the secrets of sealed episode lists."""

from pathlib import Path
from typing import Annotated

import typer

from .terminal.output import AsJson, print_json, print_pairs

app = typer.Typer(no_args_is_help=True)

SecretFile = Annotated[Path, typer.Argument(help="File with the secret.")]


@app.command()
def new(
    secret: Annotated[Path, typer.Argument(help="New file for the secret; do not put it into a submission.")],
) -> None:
    """Make a secret, and print the commitment to publish before its list is used."""
    from vitac.evaluator.tracks.sealed import make_commitment, new_secret

    print(f"commitment {make_commitment(new_secret(secret))}")


@app.command()
def verify(
    secret: SecretFile,
    commitment: Annotated[str, typer.Option(help="The commitment that was published before.")],
    track: Annotated[str, typer.Option(help="Track whose lists are derived from the secret.")] = "track_1",
    as_json: AsJson = False,
) -> None:
    """Check a published secret against its commitment, and print the digests of the tasks with its lists.

    The exit code is 0 if they agree. `vitac evaluate --secret` plays the list.
    """
    from vitac.evaluator.tracks.sealed import load_played_track, make_commitment, read_secret

    read = read_secret(secret)
    agrees = make_commitment(read) == commitment.strip().lower()
    tasks = load_played_track(track, read).tasks
    digests = {name: task.digest() for name, task in tasks.items()}
    if as_json:
        print_json({"agrees": agrees, "commitment": make_commitment(read), "track": track, "task_hashes": digests})
    else:
        print_pairs({"commitment": make_commitment(read), "agrees": "yes" if agrees else "no", **digests})
    if not agrees:
        raise typer.Exit(1)
