"""Changes that cannot be taken back: asked about first, then made in one transaction. Called by the admin nouns."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer
from vitac.envs.errors import VitacError

from ..service.database import transaction

if TYPE_CHECKING:
    from sqlalchemy.orm import Session

Yes = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
"""The option of a command that changes something for good."""

DryRun = Annotated[bool, typer.Option("--dry-run", help="Only say what would change.")]
"""The option of a command that changes several things at once."""


class ConsentMissing(VitacError):
    """The command changes something for good, and nobody is there to ask: give --yes."""


@contextmanager
def consented_transaction(question: str, *, yes: bool) -> Iterator["Session"]:
    """Ask, then open the service that the environment names and one transaction on its database.

    Raises:
        ConsentMissing: nobody can be asked.
        typer.Abort: the answer was no.
    """
    require_consent(question, yes=yes)
    with transaction() as session:
        yield session


def require_consent(question: str, *, yes: bool) -> None:
    """Ask before something is changed for good.

    Raises:
        ConsentMissing: nobody can be asked.
        typer.Abort: the answer was no.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise ConsentMissing(f"{question} Nobody can be asked here; repeat with --yes.")
    typer.confirm(question, abort=True)
