"""Changes of the admin commands: confirmed where they cannot be undone, in one transaction, undone in a dry run.

Called by the nouns.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, TypeVar

import typer
from sqlalchemy.orm import Session
from vitac.envs.errors import VitacError
from vitac.server.confirmations import Concern

from ..service.database import transaction
from ..terminal.output import warn

ShownT = TypeVar("ShownT")

Yes = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
"""The option of a command whose change cannot be undone."""

DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would change, and change nothing.")]
"""The option of every command that changes something."""

Base = Annotated[
    str | None,
    typer.Option(help="With --yes: the revision that this change was made from, as a dry run or `show` prints it."),
]
"""The option of a command that replaces what somebody else may have changed meanwhile."""

Confirmed = Annotated[
    list[str] | None,
    typer.Option("--confirm", help="With --yes: the name of a warning that you have read; may be repeated."),
]
"""The option of a command that warns of what it cannot take back."""

NOTHING_CHANGED = "Dry run: nothing was changed."
"""Printed on stderr, so that the output is what the change itself would print."""


class ConsentMissing(VitacError):
    """The change cannot be undone, and nobody is there to ask: give --yes."""


class ChangedMeanwhile(VitacError):
    """What was asked about is not what the command would do now: run it again and look at the new list."""


def change_as_shown(
    change: Callable[["Session"], ShownT],
    show: Callable[[ShownT], None],
    question: str | Callable[[ShownT], str | None],
    *,
    yes: bool,
    dry_run: bool,
    concerns: Callable[[ShownT], "Sequence[Concern]"] = lambda _: (),
) -> None:
    """Try a change, show what it does, ask, and make it. While somebody reads, nothing in the database is locked.

    Args:
        change: makes it in the transaction of a session, and returns what is shown.
        show: prints that.
        question: what is asked, or what is asked about what was shown; None: nothing changes, so nothing is asked.
        yes: do not ask.
        dry_run: only show it.
        concerns: what the change cannot take back, by what was shown: printed as warnings, and asked about one by one.

    Raises:
        ConsentMissing: nobody can be asked.
        ChangedMeanwhile: after the answer the change is another one than the one shown.
        typer.Abort: the answer was no.
    """
    with transaction() as session:
        shown = change(session)
        if dry_run:
            take_back(session)
        elif not yes:
            session.rollback()
    show(shown)
    for concern in concerns(shown):
        warn(f"{concern.name}: {concern.sentence}")
    if dry_run or yes:
        return
    asked = question if isinstance(question, str) else question(shown)
    if asked is None:
        return
    for concern in concerns(shown):
        require_consent(f"{concern.name}: do you mean that?", yes=False)
    require_consent(asked, yes=False)
    with transaction() as session:
        if change(session) != shown:
            raise ChangedMeanwhile("Something changed while you were asked, and nothing was done. Run it again.")


def resolve_base(base: str | None, *, yes: bool) -> str | None:
    """Return what a change was made against: nothing, where it is made without a question and without saying so."""
    return "" if base is None and yes else base


def resolve_confirmed(confirmed: "Sequence[str] | None", *, yes: bool) -> "Sequence[str] | None":
    """Return the names of the warnings that are confirmed; None where somebody is asked about them, or in a dry run."""
    return (confirmed or ()) if yes else None


@contextmanager
def change_transaction(*, dry_run: bool, question: str | None = None, yes: bool = False) -> Iterator["Session"]:
    """Open the service that the environment names and one transaction on its database, for one change.

    What is printed of the change is read inside and printed after the block, when it is kept.

    Args:
        dry_run: roll the change back at the end of the block, and ask nothing.
        question: asked first where the change cannot be undone.
        yes: do not ask.

    Raises:
        ConsentMissing: nobody can be asked.
        typer.Abort: the answer was no.
    """
    if question is not None and not dry_run:
        require_consent(question, yes=yes)
    with transaction() as session:
        yield session
        if dry_run:
            take_back(session)


def take_back(session: "Session") -> None:
    """End a dry run: let the database refuse what it would refuse, roll the change back, and say so."""
    session.flush()
    session.rollback()
    print(NOTHING_CHANGED, file=sys.stderr)


def require_consent(question: str, *, yes: bool) -> None:
    """Ask before a change that cannot be undone.

    Raises:
        ConsentMissing: nobody can be asked.
        typer.Abort: the answer was no.
    """
    if yes:
        return
    if not sys.stdin.isatty():
        raise ConsentMissing(f"{question} Nobody can be asked here; repeat with --yes.")
    typer.confirm(question, abort=True)
