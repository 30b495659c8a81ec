"""What holds for every command of the organizer, also for one that is added tomorrow."""

from collections.abc import Iterator
from typing import Any

from typer.core import TyperGroup
from typer.main import get_command
from vitac.cli.admin.app import app

ONLY_READ = frozenset(
    {
        "check",
        "copies",
        "data",
        "digests",
        "key",
        "list",
        "lists",
        "propose",
        "rubric",
        "show",
        "trials",
        "unserved",
        "winners",
        "witnesses",
    }
)
WRITE_A_FILE = frozenset({"backup", "receipt export", "results publish", "submission download"})
"""A new one; in the service nothing changes."""


def _leaves(command: Any, *path: str) -> Iterator[tuple[str, Any, str]]:
    """Yield the words, the command, and the help of its noun."""
    for name, found in command.commands.items():
        if isinstance(found, TyperGroup):
            yield from _leaves(found, *path, name)
        else:
            yield " ".join((*path, name)), found, command.help


COMMANDS = {name: (command, of_noun) for name, command, of_noun in _leaves(get_command(app))}


def test_each_command_prints_json_and_each_change_has_a_dry_run() -> None:
    assert len(COMMANDS) > 60
    assert {"backup", "results finalize", "team merge", "judging mark"} <= COMMANDS.keys()
    for name, (command, of_noun) in COMMANDS.items():
        options = {option for parameter in command.params for option in parameter.opts}
        verb = name.split()[-1]
        assert "--json" in options, name
        assert ("--dry-run" in options) == (verb not in ONLY_READ and name not in WRITE_A_FILE), name
        assert "--yes" not in options or "--dry-run" in options, f"{name}: what is asked about can be tried first"
        assert command.help.rstrip().endswith("."), f"{name} says what it does"
        assert " " not in name or verb in of_noun, f"the help of the noun lists {name}"
