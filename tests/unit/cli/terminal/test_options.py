"""An option that several commands have is the same in all of them."""

from collections.abc import Iterator
from typing import Any

import pytest
from typer.core import TyperGroup
from typer.main import get_command
from vitac.cli.main import NOUNS, build_app


def leaves(command: Any, *path: str) -> Iterator[tuple[str, Any]]:
    for name, found in command.commands.items():
        if isinstance(found, TyperGroup):
            yield from leaves(found, *path, name)
        else:
            yield " ".join((*path, name)), found


@pytest.fixture(scope="module")
def commands() -> dict[str, Any]:
    """Every command of every noun, by its words."""
    nouns = ((noun.name, get_command(build_app([noun.name])).commands[noun.name]) for noun in NOUNS)  # type: ignore[attr-defined]
    return {
        " ".join(filter(None, (noun, verb))): command
        for noun, found in nouns
        for verb, command in (leaves(found) if isinstance(found, TyperGroup) else [("", found)])
    }


def helps_of(option: str, commands: dict[str, Any]) -> dict[str, str]:
    """The help of an option, by the command that has it."""
    return {
        name: parameter.help
        for name, command in commands.items()
        for parameter in command.params
        if option in parameter.opts
    }


@pytest.mark.parametrize(
    ("option", "at_least", "others"),
    [
        ("--server", 20, {"logout"}),
        ("--token-file", 20, {"login"}),
        ("--json", 90, {"evaluate", "resimulate", "sensor evaluate"}),  # a file
        ("--episodes", 2, {"log verify", "receipt audit", "train clone"}),  # how many
        ("--workers", 2, {"demo", "serve", "train reference"}),
        ("--assets", 3, {"evaluate"}),
    ],
)
def test_a_shared_option_has_one_help(commands: dict[str, Any], option: str, at_least: int, others: set[str]) -> None:
    found = helps_of(option, commands)
    assert len(found) >= at_least, found
    if option == "--server":  # without it an organizer's command works on this machine
        others |= {name for name in found if name.startswith("admin ")}
    shared = {name: text for name, text in found.items() if name not in others}
    assert len(set(shared.values())) == 1, shared
