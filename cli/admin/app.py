"""`vitac admin`: the organizer's commands, for the service of this machine or one at an address."""

from collections.abc import Callable, Mapping
from typing import Any

import typer

from ..client.verbs import add_verbs
from ..terminal.output import TokenFile
from . import competition, files, machine
from .door import Server, open_door
from .verbs import NOUNS

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

FURTHER: Mapping[tuple[str, str], Callable[..., Any]] = {
    ("competition", "check"): competition.check,
    ("competition", "apply"): competition.apply,
    ("results", "publish"): files.publish,
    ("baseline", "publish"): files.publish_baseline,
    ("receipt", "export"): files.export,
    ("submission", "download"): files.download,
    ("token", "add"): files.add_token,
    ("track", "check"): machine.check_track,
    ("appeal", "replay"): machine.replay,
}
"""Verbs that are more than a request."""


@app.callback()
def organize(context: typer.Context, server: Server = None, token_file: TokenFile = None) -> None:
    """Organize competitions: teams, tokens, submissions, evaluations, workers.

    On the machine of the service without --server, whether it runs or not; from elsewhere with --server and an
    organizer's token, of VITAC_TOKEN or of `vitac login`. VITAC_SERVER is not used here.
    """
    context.find_root().obj = {"server": server, "token_file": token_file}


def _add_nouns() -> None:
    for name, noun in NOUNS.items():
        verbs = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
        verbs.callback()(lambda: None)  # so that a single verb is not the noun itself
        for further in noun.further:
            verbs.command(further)(FURTHER[name, further])
        add_verbs(verbs, noun.verbs, open_door, Server)
        listed = ", ".join([*noun.further, *(verb.name for verb in noun.verbs)])
        app.add_typer(verbs, name=name, help=f"{noun.title}: {listed}.")


_add_nouns()
app.command("backup")(machine.back_up)
app.command("restore")(machine.restore)
