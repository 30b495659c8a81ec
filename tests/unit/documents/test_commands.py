"""Every `vitac` command that documents, pages and messages show can be typed: verbs, options and arguments exist."""

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import typer
from shown_documents import FENCE, documents
from vitac.cli.main import NOUNS, build_app

SOURCES = (
    *("cli", "envs", "evaluator", "server", "setup", "station", "training"),
    *("web/pages", "web/templates", "worker"),
)
NAMED_IN_SOURCES = re.compile(r"`((?:\./)?vitac [^`\n]+)`|<code>((?:\./)?vitac [^<]+)</code>")
LAUNCHER_OPTIONS = ("--maniskill", "--torch")
ENDS_OF_A_COMMAND = {"|", "&", "&&", ";", ">", ">>", "<"}
OK = "can be typed"
NAMED = "  # in a sentence"
"""Follows a command that is named only, so that the value of its last option may be left out."""
OURS = re.compile(r"(?:benchmarks|competitions|docs|evaluator|examples|setup|tests|web)/[\w./*-]+")


def lines_of_code(markdown: str) -> Iterator[str]:
    """Each line of a block that is not Python, and each span of code."""
    for language, block in FENCE.findall(markdown):
        if language != "python":
            yield from block.replace("\\\n", " ").splitlines()
    for span in re.findall(r"`([^`]+)`", FENCE.sub("", markdown)):
        yield " ".join(span.split()) + NAMED


def complaints(name: str, line: str) -> Iterator[str]:
    for words in vitac_commands(line.removesuffix(NAMED)):
        yield f"{name}: {line}: {what_is_wrong(words, named=line.endswith(NAMED)) or OK}"


def words_of(line: str) -> list[list[str]]:
    """Return the words of each command of a line."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
    lexer.whitespace_split = True
    found: list[list[str]] = [[]]
    for word in lexer:
        if word in ENDS_OF_A_COMMAND:
            found.append([])
        else:
            found[-1].append(word)
    return found


def vitac_commands(line: str) -> Iterator[list[str]]:
    """What follows `vitac` in each command of a line that calls it."""
    if re.search(r"(?:^|[\s/])vitac\s", line) is None or "import vitac" in line:
        return
    for words in words_of(line):
        called = [number for number, word in enumerate(words) if word in ("vitac", "./vitac", ".venv/bin/vitac")]
        if called:
            yield words[called[0] + 1 :]


@cache
def command_of(noun: str) -> typer.core.TyperCommand | typer.core.TyperGroup:
    app = typer.main.get_command(build_app([noun]))
    assert isinstance(app, typer.core.TyperGroup)
    return app.commands[noun]  # type: ignore[return-value]


def what_is_wrong(words: list[str], *, named: bool = False) -> str | None:
    """Return why a command cannot be typed, or nothing."""
    words = [word for word in words if word != "..."]
    while words and words[0] in LAUNCHER_OPTIONS:
        words = words[1:]
    if not words or words[0] in ("--help", "--version", "test"):
        return None
    if words[0] not in {noun.name for noun in NOUNS}:
        return f"no command {words[0]!r}"
    command, rest = command_of(words[0]), words[1:]
    while isinstance(command, typer.core.TyperGroup):
        if not rest or (rest[0] not in command.commands and "." not in rest[0]):
            return None if not rest or rest == ["--help"] else f"no verb {rest[0]!r}"
        verb = rest.pop(0) if rest[0] in command.commands else "run"  # `vitac train RECIPE.yaml`
        command = command.commands[verb]  # type: ignore[assignment]
    parser = command.make_parser(typer.Context(command, info_name="vitac"))
    try:
        given, extra, _ = parser.parse_args([*rest])
    except Exception as error:  # noqa: BLE001 - whatever the parser says of the words
        message = str(getattr(error, "message", error))
        return None if named and message.startswith(f"Option '{rest[-1]}' requires") else message
    lacking = [str(param.name) for param in command.params if param.required and given.get(str(param.name)) is None]
    if lacking and not named and "--help" not in rest:
        return f"lacks {', '.join(lacking)}"
    return f"unexpected {' '.join(extra)}" if extra else None


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("./vitac evaluate my_folder --task peg-insertion --json result.json   # all of them", None),
        ("VITAC_TRACKS_DIR=tracks ./vitac serve --workers 2", None),
        ("uvx --from 'vitac.whl[show]' vitac show peg-insertion --episode 5", None),
        ("./vitac --torch train reference peg-insertion --out RUN", None),
        ("./vitac train recipe.yaml --out RUN", None),
        ("./vitac admin token add --organizer --label 'my laptop'", None),
        ("./vitac evalute my_folder", "no command 'evalute'"),
        ("./vitac admin team remove", "no verb 'remove'"),
        ("./vitac evaluate my_folder --tasks peg-insertion", "No such option: --tasks"),
        ("./vitac show peg-insertion --episode", "Option '--episode' requires an argument"),
        ("./vitac whoami now", "unexpected now"),
        ("./vitac train export RUN", "lacks submission"),
        ("./vitac check", "lacks submission"),
    ],
)
def test_a_command_that_cannot_be_typed_is_found(line: str, complaint: str | None) -> None:
    (words,) = vitac_commands(line)
    found = what_is_wrong(words)
    assert found == complaint or (complaint is not None and complaint in str(found))


def test_commands_of_the_documents_can_be_typed(repository: Path) -> None:
    found = [
        told
        for name, markdown in documents(repository)
        for line in lines_of_code(markdown)
        for told in complaints(name, line)
    ]
    assert [told for told in found if not told.endswith(OK)] == []
    assert len(found) > 200


def test_commands_of_messages_and_pages_can_be_typed(repository: Path) -> None:
    found: list[str] = []
    for path in sorted(path for folder in SOURCES for path in (repository / folder).rglob("*.*")):
        if path.suffix in (".py", ".html", ".sh"):
            for spans in NAMED_IN_SOURCES.findall(path.read_text()):
                for line in re.sub(r"\{+[^{}]*\}+", "VALUE", "".join(spans)).splitlines():
                    found += complaints(str(path.relative_to(repository)), line + NAMED)
    assert [told for told in found if not told.endswith(OK)] == []
    assert len(found) > 80


def test_files_that_commands_name_exist(repository: Path) -> None:
    """Those of the repository; what the tutorial writes is not there before it has run."""
    missing = []
    for name, markdown in documents(repository):
        for line in lines_of_code(markdown):
            if re.match(r"(?:\S+=\S+ )*(?:\./vitac|vitac|(?:\S+/)?python|(?:\S+/)?pytest|bash|sh) ", line):
                for found in OURS.findall(line):
                    if not any(repository.glob(found.rstrip("/."))) and "/tutorial_" not in found:
                        missing.append(f"{name}: {line}: {found}")
    assert missing == []


def test_commands_to_type_are_those_of_a_checkout(repository: Path) -> None:
    """Who follows a document there has no `vitac` on the path; the quick start says what to write without one."""
    typed = [
        (name, line)
        for name, markdown in documents(repository)
        for language, block in FENCE.findall(markdown)
        for line in block.splitlines()
        if language in ("", "sh") and re.match(r"(?:\S+=\S+ )*(?:\./)?vitac [a-z-]", line)
    ]
    assert [each for each in typed if not re.match(r"(?:\S+=\S+ )*\./vitac ", each[1])] == []
    assert len(typed) > 100
