"""`vitac admin competition check` and `apply`: a competition's file, shown before it is applied."""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..client.verbs import NOTHING_CHANGED, Base, Confirmed, Door, DryRun, Yes, require_consents
from ..terminal.output import AsJson, TokenFile, moment, print_json, print_table, warn
from .door import Server, open_door

if TYPE_CHECKING:
    from vitac.server.competitions.definition import CompetitionDefinition

CompetitionFile = Annotated[Path, typer.Argument(help="The competition's file (YAML).", exists=True, dir_okay=False)]
_LINES, _STAGES = 10, 4
"""Maximum number of lines of the summary of a new competition, and of stages in each."""
APPLY = "PUT /competitions/{competition}/definition"


def check(file: CompetitionFile, as_json: AsJson = False) -> None:
    """Check a competition's file without a service; the exit code is 0 if it can be applied."""
    from vitac.server.competitions.applying import list_warnings
    from vitac.server.competitions.definition import read_competition

    definition = read_competition(file)
    if as_json:
        print_json(definition.model_dump(mode="json"))
        return
    print_table(
        ("track", "stage", "opens", "closes", "takes", "list", "for"),
        [
            [
                name,
                stage.name,
                moment(stage.opens),
                moment(stage.closes),
                ", ".join(stage.accepts) if track.taken_here else "elsewhere",
                stage.list.value if track.taken_here else None,
                stage.qualified.sentence if stage.qualified else "all teams",
            ]
            for name, track in definition.tracks.items()
            for stage in track.stages
        ],
        none="",
    )
    for warning in list_warnings(definition, at=datetime.now(UTC)):
        warn(warning)


def apply(
    context: typer.Context,
    file: CompetitionFile,
    base: Base = None,
    confirm: Confirmed = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Show what a competition's file changes, ask, and apply it; other competitions stay as they are."""
    from vitac.evaluator.strict_model import read_yaml
    from vitac.server.competitions.definition import CompetitionDefinition

    definition = read_yaml(CompetitionDefinition, file)  # its tracks are known where it is applied
    content = {"competition": definition.name, "definition": definition.model_dump(mode="json")}
    values = content | {"base": base, "confirm": confirm or []}
    with open_door(context, server, token_file) as door:
        if yes and not dry_run:
            done = door.call(APPLY, values)
            _show(done, definition, as_json=as_json)
        else:
            done = door.call(APPLY, values, dry_run=True)
            _show(done, definition, as_json=as_json)
            if dry_run:
                _print_revision(done)
                return
            if done["changes"]:
                _ask_and_apply(door, content, done)
    if done["changes"] and not as_json:
        print("applied")


def _ask_and_apply(door: Door, content: dict[str, Any], tried: Any) -> None:
    """Ask about what was tried, and apply it; somebody's change meanwhile is refused by its revision."""
    require_consents(tried["concerns"], f"Apply these {len(tried['changes'])} changes?")
    confirmed = [concern["name"] for concern in tried["concerns"]]
    door.call(APPLY, content | {"base": tried["revision"], "confirm": confirmed})


def _show(answer: Any, definition: CompetitionDefinition, *, as_json: bool) -> None:
    if as_json:
        print_json(answer["changes"])
    elif answer["changes"] and not answer["revision"]:
        print("\n".join(_summarize(definition)))
    else:
        rows = [[each["place"], _text(each["before"]), _text(each["after"])] for each in answer["changes"]]
        print_table(("what", "before", "after"), rows, none="Nothing changes.")
    for warning in answer["warnings"]:
        warn(warning)


def _summarize(new: CompetitionDefinition) -> list[str]:
    """Return what a new competition is, in at most ten lines."""
    prize = sum(prize.amount * prize.winners for track in new.tracks.values() for prize in track.prizes)
    stages = sum(len(track.stages) for track in new.tracks.values())
    lines = [
        f"{new.name}: {new.title}",
        f"tracks: {len(new.tracks)}, stages: {stages}, prizes: {prize} {new.currency}, rules: {len(new.rules)}, "
        f"teams {'anonymous' if new.anonymous else 'by name'}",
    ]
    for name, track in new.tracks.items():
        named = [f"{stage.name} {stage.opens:%F %R} to {stage.closes:%F %R} UTC" for stage in track.stages[:_STAGES]]
        more = f"; {len(track.stages) - _STAGES} more" if len(track.stages) > _STAGES else ""
        lines.append(f"{name}: {'; '.join(named)}{more}{'' if track.taken_here else ' (collected elsewhere)'}")
    hidden = len(lines) - _LINES
    return lines if hidden <= 0 else [*lines[: _LINES - 1], f"and {hidden + 1} more tracks"]


def _print_revision(tried: Any) -> None:
    print(NOTHING_CHANGED, file=sys.stderr)
    for concern in tried["concerns"]:
        warn(f"{concern['name']}: {concern['sentence']}")
    if tried["changes"] and tried["revision"]:
        print(f"Made against revision {tried['revision']}: --yes needs --base {tried['revision']}.", file=sys.stderr)


def _text(value: object) -> str | None:
    return ", ".join(map(str, value)) if isinstance(value, list) else None if value is None else str(value)
