"""Makes verbs of functions that work in one transaction. Called by the nouns.

A function takes a session and what its verb names, and returns what is printed: a view or a record, or several. The
verb gets the options that all verbs of its kind share: `--json`, of changes `--dry-run`, of those that are asked about
`--yes`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import Parameter, Signature, signature
from typing import Any, TypeVar

import typer
from pydantic import BaseModel
from sqlalchemy.orm import Session

from ..service.database import transaction
from ..terminal.output import AsJson, print_done, print_record, print_records
from .consent import DryRun, Yes, change_transaction

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def change(
    app: typer.Typer,
    name: str | None = None,
    *,
    question: str | None = None,
    done: str | None = None,
    unknown: Sequence[str] = (),
) -> Callable[[FunctionT], FunctionT]:
    """Make a function a verb that changes something and prints it as it is then.

    Args:
        app: the noun.
        name: of the verb; by default that of the function.
        question: asked first where the change cannot be undone; arguments of the verb stand in it as `{team}`.
        done: sentence to print instead of the record, with arguments as in the question.
        unknown: fields of the record that a dry run does not know.
    """

    def register(function: FunctionT) -> FunctionT:
        def verb(*, dry_run: bool, as_json: bool, yes: bool = False, **given: Any) -> None:
            asked = question and question.format(**given)
            with change_transaction(dry_run=dry_run, question=asked, yes=yes) as session:
                changed = function(session, **given)
                session.flush()
                record = _as_record(changed) | (dict.fromkeys(unknown) if dry_run else {})
            if done is None:
                print_record(record, as_json=as_json)
            else:
                print_done(done.format(**given), record, as_json=as_json)

        _add(app, name, function, verb, ({"yes": Yes} if question else {}) | {"dry_run": DryRun})
        return function

    return register


def show(app: typer.Typer, name: str | None = None) -> Callable[[FunctionT], FunctionT]:
    """Make a function a verb that prints one record."""

    def register(function: FunctionT) -> FunctionT:
        def verb(*, as_json: bool, **given: Any) -> None:
            with transaction() as session:
                record = _as_record(function(session, **given))
            print_record(record, as_json=as_json)

        _add(app, name, function, verb, {})
        return function

    return register


def list_records(app: typer.Typer, *columns: str, none: str, name: str = "list") -> Callable[[FunctionT], FunctionT]:
    """Make a function a verb that prints records.

    Args:
        app: the noun.
        columns: fields of the table; `--json` prints all.
        none: printed if there are no records.
        name: of the verb.
    """

    def register(function: Callable[..., Iterable[object]]) -> Any:
        def verb(*, as_json: bool, **given: Any) -> None:
            with transaction() as session:
                records = [_as_record(found) for found in function(session, **given)]
            print_records(records, columns, none=none, as_json=as_json)

        _add(app, name, function, verb, {})
        return function

    return register


def _as_record(shown: BaseModel | Mapping[str, object] | Any) -> dict[str, object]:
    if isinstance(shown, BaseModel):
        return shown.model_dump()
    return dict(shown if isinstance(shown, Mapping) else vars(shown))


def _add(app: typer.Typer, name: str | None, function: Callable[..., Any], verb: Any, options: dict[str, Any]) -> None:
    """Add a verb with the parameters of its function, but the session, and further options that are off by default."""
    first, *own = signature(function).parameters.values()
    if first.annotation is not Session:
        raise TypeError(f"expected a session as the first parameter of {function.__name__}, got {first}")
    further = [
        Parameter(option, Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for option, kind in (options | {"as_json": AsJson}).items()
    ]
    verb.__signature__ = Signature([parameter.replace(kind=Parameter.KEYWORD_ONLY) for parameter in own] + further)
    app.command(name or function.__name__.replace("_", "-"), help=function.__doc__)(verb)
