"""Makes verbs of the API's operations, as `operations.json` describes them; the tables of nouns say what is added.

An operation gives a verb its arguments and options, their types, limits and help. A verb that changes something gets
`--dry-run` and `--yes`, also where nobody is asked, so that scripts give it everywhere; every verb `--json`.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import KW_ONLY, dataclass, field
from datetime import datetime
from functools import cache
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import quote
from uuid import UUID

import typer
from vitac.errors import VitacError

from ..terminal.output import AsJson, Server, TokenFile, moment, print_json, print_pairs, print_records, warn
from .answers import Answer, decode
from .http import Client

OPERATIONS = Path(__file__).with_name("operations.json")
PREFIX = "/api/v1"
OWN_TEAM = "the team of the token"
"""Stands for its id in the table of a team's own verbs."""
NOTHING_CHANGED = "Dry run: nothing was changed."
"""Printed on stderr, so that the output is what the change itself would print."""
_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)")
_TYPES: Mapping[str, type] = {"string": str, "integer": int, "number": float, "boolean": bool, "uuid": UUID}

Yes = Annotated[bool, typer.Option("--yes", help="Do not ask.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Print what would change, and change nothing.")]
Base = Annotated[
    str | None,
    typer.Option(help="With --yes: the revision that this change was made from, as a dry run or `show` prints it."),
]
Confirmed = Annotated[
    list[str] | None,
    typer.Option("--confirm", help="With --yes: the name of a warning that you have read; may be repeated."),
]


class ConsentMissing(VitacError):
    """The change cannot be undone, and nobody is there to ask: give --yes."""


class CompetitionNotNamed(VitacError):
    """The service has no competition, or several of which one has to be named."""


class NoTeam(VitacError):
    """The token belongs to no team, or the team has no such member."""


@dataclass(frozen=True, kw_only=True)
class Field:
    """What an operation takes, as `operations.json` says it."""

    name: str
    place: str
    needed: bool
    type: str
    many: bool = False
    choices: Sequence[str] = ()
    min: float | None = None
    max: float | None = None
    default: Any = None
    help: str | None = None

    @property
    def word(self) -> str:
        """Name of its argument or option."""
        return self.name.removesuffix("_id")

    @property
    def python_type(self) -> Any:
        """Type that the command line converts to; teams and members are named."""
        names = self.name in {"team_id", "member_id"}
        kind: Any = Literal[tuple(self.choices)] if self.choices else str if names else _TYPES[self.type]
        return list[kind] if self.many else kind


@dataclass(frozen=True, kw_only=True)
class Operation:
    """A route of the API."""

    method: str
    path: str
    text: str
    fields: Sequence[Field]

    @property
    def changes(self) -> bool:
        """Whether it changes something."""
        return self.method != "GET"

    def has(self, name: str) -> bool:
        """Return whether it takes a field."""
        return any(field.name == name for field in self.fields)


@cache
def _described() -> Mapping[str, Any]:
    content: Mapping[str, Any] = json.loads(OPERATIONS.read_text(encoding="utf-8"))
    return content


@cache
def find_operation(name: str) -> Operation:
    """Return an operation by its method and path, as `GET /teams/{team_id}`."""
    method, _, path = name.partition(" ")
    described = _described()[name]
    return Operation(
        method=method, path=path, text=described["text"], fields=[Field(**each) for each in described["fields"]]
    )


@dataclass(frozen=True, kw_only=True)
class Door:
    """A service, at an address or in this process, and what its operations are called with."""

    client: Client

    def call(self, name: str, values: Mapping[str, object], *, dry_run: bool = False) -> Any:
        """Call an operation with the values of its fields, and return what is answered; names become ids."""
        answer = self.send(name, values, dry_run=dry_run)
        return decode(answer) if answer.content else None

    def send(self, name: str, values: Mapping[str, object], *, dry_run: bool = False) -> Any:
        """Call the same, and return the answer with its bytes."""
        operation = find_operation(name)
        placed: dict[str, dict[str, object]] = {"path": {}, "query": {}, "body": {}}
        for each in operation.fields:
            value = _plain(values.get(each.name))
            if each.name == "competition" and each.place == "path":
                value = self.find_competition(value, values.get("track"))
            elif each.name == "team_id":
                value = self.find_team(str(value))
            elif each.name == "member_id":
                value = self.find_member(str(values["team_id"]), str(value))
            if value is not None or (each.needed and each.place == "body"):
                placed[each.place][each.name] = value
        path = operation.path.format(**{key: quote(str(value), safe="") for key, value in placed["path"].items()})
        has_body = any(each.place == "body" for each in operation.fields)
        return self.client.send(
            operation.method,
            PREFIX + path,
            headers={"Content-Type": "application/json"} | ({"Dry-Run": "true"} if dry_run else {}),
            params=placed["query"],
            content=json.dumps(placed["body"]).encode() if has_body else None,
        )

    def find_competition(self, name: object, track: object = None) -> object:
        """Return the name of a competition; without one that of the only competition, or the only one of a track.

        Raises:
            CompetitionNotNamed: there is none, or there are several.
        """
        if name is not None:
            return name
        listed = self.call("GET /competitions", {})["items"]
        names = [each["name"] for each in listed if track is None or track in each["tracks"]]
        names = names or [each["name"] for each in listed]
        if len(names) != 1:
            raise CompetitionNotNamed(
                f"This service has several competitions; name one of {', '.join(sorted(names))} with --competition."
                if names
                else "This service has no competition; `vitac admin competition apply FILE` makes one."
            )
        return names[0]

    def find_team(self, named: str) -> str:
        """Return the id of a team by its name or id, or of the token's own.

        Raises:
            NoTeam: the token is an organizer's or a judge's.
        """
        with suppress(ValueError):
            return str(UUID(named))
        if named != OWN_TEAM:
            (team,) = self.call("GET /teams", {"name": named})
            return str(team["id"])
        own = self.client.me()["team"]
        if own is None:
            raise NoTeam("This token belongs to no team; `vitac whoami` shows whose it is.")
        return str(own["id"])

    def find_member(self, team: str, named: str) -> str:
        """Return the id of a member of a team by name.

        Raises:
            NoTeam: the team has none of that name.
        """
        shown = self.call("GET /teams/{team_id}", {"team_id": team})
        for member in shown["members"]:
            if _key(member["name"]) == _key(named) and member["left_at"] is None:
                return str(member["id"])
        raise NoTeam(f"{shown['name']} has no member {named!r}; its page and `team show` list them.")


OpenDoor = Callable[[typer.Context, str | None, Path | None], AbstractContextManager[Door]]
Given = Mapping[str, Any]
"""Values of a verb by the names of its arguments and options."""


@dataclass(frozen=True)
class Verb:
    """What a table adds to an operation.

    Attributes:
        name: of the verb.
        operation: method and path.
        help: in place of the operation's text.
        fixed: values of fields that the verb stands for.
        usual: values of fields that need one, where none is given.
        only: fields that are offered; None: all that are not fixed.
        arguments: fields of query and body that are given without an option.
        words: other names of options, such as `--uphold/--reject`.
        needed: fields that the verb needs though the operation does not.
        parse: makes the value of a field of what was typed.
        asks: question before a change that cannot be undone, with arguments as `{team}`.
        tries: whether what a dry run answers is shown before the question.
        looks: whether the operation wants to know what was looked at, also where nobody is asked.
        done: sentence to print in place of the record.
        of: field of the answer that holds what is printed.
        columns: fields of a table, if it is one.
        none: printed if the table is empty.
        only_json: fields that are only in JSON.
        unknown: fields of the answer that a dry run does not know.
        answers: what is printed of an operation that answers nothing.
        show: prints an answer for people in another way.
        warns: prints warnings about an answer.
    """

    name: str
    operation: str
    _: KW_ONLY
    help: str | None = None
    fixed: Mapping[str, object] = field(default_factory=dict)
    usual: Mapping[str, object] = field(default_factory=dict)
    only: Sequence[str] | None = None
    arguments: Sequence[str] = ()
    words: Mapping[str, str] = field(default_factory=dict)
    needed: Sequence[str] = ()
    parse: Mapping[str, Callable[[Any], object]] = field(default_factory=dict)
    asks: str | None = None
    tries: bool = False
    looks: bool = False
    done: str | None = None
    of: str | None = None
    columns: Sequence[str] = ()
    none: str = ""
    only_json: Sequence[str] = ()
    unknown: Sequence[str] = ()
    answers: Mapping[str, object] = field(default_factory=dict)
    show: Callable[[Any, Given], None] | None = None
    warns: Callable[[Any], Iterator[str]] = lambda _: iter(())

    def offered(self) -> list[Field]:
        """Return the fields that the command line takes, arguments first."""
        free = [
            each
            for each in find_operation(self.operation).fields
            if each.name not in self.fixed
            and each.name not in {"shown", "confirm"}
            and (self.only is None or each.place == "path" or each.name in self.only)
        ]
        order = {name: number for number, name in enumerate(self.arguments)}
        return sorted(free, key=lambda each: (not self.is_argument(each), order.get(each.name, -1)))

    def is_argument(self, each: Field) -> bool:
        """Return whether a field is given without an option."""
        return each.name in self.arguments or (each.place == "path" and each.name != "competition")


def add_verbs(app: typer.Typer, verbs: Sequence[Verb], open_door: OpenDoor, server: Any = Server) -> None:
    """Add verbs to a noun; `server` is the option that names the service."""
    for verb in verbs:
        app.command(verb.name, help=verb.help or find_operation(verb.operation).text)(
            _make_command(verb, open_door, server)
        )


def _make_command(verb: Verb, open_door: OpenDoor, server_option: Any) -> Callable[..., None]:
    def command(
        *,
        context: typer.Context,
        server: str | None,
        token_file: Path | None,
        as_json: bool,
        yes: bool = False,
        dry_run: bool = False,
        **given: Any,
    ) -> None:
        with open_door(context, server, token_file) as door:
            run(verb, door, given, yes=yes, dry_run=dry_run, as_json=as_json)

    operation = find_operation(verb.operation)
    parameters = [Parameter("context", Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    parameters += [_parameter(verb, each) for each in verb.offered()]
    if operation.has("confirm"):
        parameters.append(Parameter("confirm", Parameter.KEYWORD_ONLY, default=None, annotation=Confirmed))
    if operation.changes:
        parameters.append(Parameter("yes", Parameter.KEYWORD_ONLY, default=False, annotation=Yes))
    if operation.changes:
        parameters.append(Parameter("dry_run", Parameter.KEYWORD_ONLY, default=False, annotation=DryRun))
    for name, kind in (("server", server_option), ("token_file", TokenFile)):
        parameters.append(Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=kind))
    parameters.append(Parameter("as_json", Parameter.KEYWORD_ONLY, default=False, annotation=AsJson))
    command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    return command


def _parameter(verb: Verb, each: Field) -> Parameter:
    limits: dict[str, Any] = {"min": each.min, "max": each.max} if each.type in {"integer", "number"} else {}
    is_needed = each.name in verb.needed or (each.needed and each.name not in verb.usual)
    is_needed &= not (each.name == "competition" and each.place == "path")
    kind = str if each.name in verb.parse else each.python_type
    if each.name in verb.parse and each.many | (each.type == "object"):
        kind = list[str]
    help_text = each.help or HELPS.get(each.name, "")
    if verb.is_argument(each):
        said = typer.Argument(help=help_text, **({} if kind is str else limits))
    else:
        word = verb.words.get(each.name, f"--{each.word.replace('_', '-')}")
        said = typer.Option(word, help=help_text, **limits)
    default: Any = Parameter.empty if is_needed else verb.usual.get(each.name, each.default if kind is bool else None)
    if default is None:
        kind = kind | None
    return Parameter(each.word, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, said])


HELPS: dict[str, str] = {
    "team_id": "Name or id of the team.",
    "member_id": "Name of the member.",
    "competition": "Name of the competition; needed where there are several.",
    "track": "Name of the track.",
    "stage": "Name of the stage.",
    "submission_id": "Id of the submission.",
    "evaluation_id": "Id of the evaluation.",
    "rejudgement_id": "Id of the rejudgement.",
    "token_id": "Id of the token (not its secret).",
    "worker_id": "Id of the worker.",
    "notice_id": "Id of the notice.",
    "webhook_id": "Id of the webhook, as `list` prints it.",
    "announcement_id": "Number of the announcement.",
    "question_id": "Number of the question.",
    "appeal_id": "Number of the appeal.",
    "quota": "The quota, as `list` shows it.",
    "name": "Its name.",
    "state": "Only those in this state.",
    "limit": "Maximum number of rows.",
}
"""Help of fields of which the API's description says nothing."""


def run(verb: Verb, door: Door, given: dict[str, Any], *, yes: bool, dry_run: bool, as_json: bool) -> None:
    """Call the operation of a verb and print what it answers; where it asks, what it would do is tried first.

    Raises:
        ConsentMissing: nobody can be asked.
        typer.Abort: the answer was no.
    """
    operation, words = find_operation(verb.operation), {each.name: each.word for each in verb.offered()}
    values: dict[str, Any] = {name: given.get(word) for name, word in words.items()} | dict(verb.fixed)
    for name, parse in verb.parse.items():
        values[name] = parse(values[name])
    if operation.has("confirm"):
        values["confirm"] = given.get("confirm") or []
    if verb.asks and not yes:
        tried = door.call(verb.operation, values, dry_run=True)
        if dry_run or verb.tries:
            _print(verb, tried, given, dry_run=dry_run, as_json=as_json)
        if dry_run:
            return
        concerns = tried.get("concerns", ()) if isinstance(tried, dict) else ()
        require_consents(concerns, verb.asks.format(**given))
        if operation.has("shown"):
            values["shown"] = tried["revision"]
        if concerns:
            values["confirm"] = [concern["name"] for concern in concerns]
        answer = door.call(verb.operation, values)
        if not verb.tries:
            _print(verb, answer, given, dry_run=False, as_json=as_json)
        return
    if verb.looks and not dry_run:
        values["shown"] = door.call(verb.operation, values, dry_run=True)["revision"]
    answer = door.call(verb.operation, values, dry_run=dry_run)
    _print(verb, answer, given, dry_run=dry_run, as_json=as_json)


def _print(verb: Verb, answer: Any, given: Given, *, dry_run: bool, as_json: bool) -> None:
    if answer is None:
        arguments = {each.word: given.get(each.word) for each in verb.offered() if each.place == "path"}
        answer = Answer({name: value for name, value in arguments.items() if value is not None} | dict(verb.answers))
    if dry_run:
        print(NOTHING_CHANGED, file=sys.stderr)
        for place in verb.unknown:
            _forget(answer, place.split("."))
    content = answer if verb.of is None else answer[verb.of]
    if as_json:
        print_json(content)
    elif verb.done is not None:
        print(verb.done.format(**given))
    elif verb.show is not None:
        verb.show(answer, given)
    elif verb.columns or isinstance(content, list):
        print_rows(content, verb.columns, none=verb.none)
    else:
        print_fields({name: value for name, value in content.items() if name not in verb.only_json})
    for sentence in verb.warns(answer):
        warn(sentence)


def _forget(answer: Any, place: Sequence[str]) -> None:
    for name in place[:-1]:
        answer = answer[name]
    answer[place[-1]] = None


def require_consents(concerns: Sequence[Mapping[str, str]], question: str) -> None:
    """Warn of what a change cannot take back, ask about each, and then about the change.

    Raises:
        ConsentMissing: nobody can be asked.
        typer.Abort: the answer was no.
    """
    for concern in concerns:
        warn(f"{concern['name']}: {concern['sentence']}")
    for asked in (*(f"{concern['name']}: do you mean that?" for concern in concerns), question):
        require_consent(asked, yes=False)


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


def print_rows(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], *, none: str) -> None:
    """Print some fields of objects of an answer as a table."""
    cells = [{name: readable(row[name]) for name in columns} for row in rows]
    print_records(cells, columns, none=none, as_json=False)


def print_fields(record: Mapping[str, Any]) -> None:
    """Print the fields of an object of an answer, one a line."""
    print_pairs({name: readable(value) for name, value in record.items()})


def readable(value: Any) -> Any:
    """Return a value of an answer as people read it: times to the second, lists by commas."""
    if isinstance(value, str) and _TIME.fullmatch(value):
        return moment(datetime.fromisoformat(value))
    if isinstance(value, list):
        return ", ".join(str(readable(each)) for each in value)
    return value


def _key(name: str) -> str:
    """Return what is equal for all ways to write a name."""
    return " ".join(name.split()).casefold()


def _plain(value: Any) -> Any:
    """Return what JSON can hold."""
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return str(value) if isinstance(value, UUID | Path) else value
