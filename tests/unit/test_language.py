"""Words that `docs/glossary.md` replaces do not come back: in names, messages, docstrings, pages and documents."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

SUFFIXES = {".py", ".html", ".js", ".sh", ".md", ".yaml", ".yml"}
PLACES = (
    *("cli", "web", "viewer", "worker", "server", "evaluator", "examples"),
    *("envs", "station", "tests/physics"),
    *("docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md"),
    *("vitac", "setup", "docker", "docker-compose.yml"),
)
GLOSSARY = "docs/glossary.md"
REPLACED = {
    r"\bcame\b(?! from)": "expected X, got Y",
    r"\bmost_(?!common\b)\w+|\bMOST_\w+": "max_...",
    r"\bsilence_s\b|\bfalls? silent\b|\bin silence\b|\bwas silent\b": "idle_timeout_s, heartbeat, silently",
    r"\bcrew\b": "process pool",
    r"\bleft_out\b": "is_ignored",
    r"\bgoodbye\b": "heartbeat",
    r"\bclass(es)? of machines\b": "platform class",
    r"\bnot whole gzip\b": "The gzip data is truncated or corrupt.",
    r"\bany more\b": "no longer",
    r"\bis told\b|\btold by\b": "is given, is notified",
    r"\blog audit\b|\baudits\b": "action match (an audit log records changes by people)",
}

# What docstrings of functions began with that said what they return, in place of what they do. Properties are nouns.
NO_VERBS = re.compile(
    "The|An?|All|One|Each|Whether|How|Which|Why|What|Where|When|After|Under|For|In|Out|Later|Present|Fast|High|"
    "First|Best|Largest|Smallest|Closest|Mean|Nodal|Consistent|Sliding|Rotated|Counter-clockwise|Commanded|Compiling|"
    "SHA-256|Addresse?s?|Ids?|Folders?|Contents|Limits|Masks?|Motion|Heights?|Depths?|Distances?|Pictures?|Rewards?|"
    "Pairs?|Parts?|Places|Points?|Nodes?|Edges?|Corners?|Vertices|Triangles?|Volumes?|Centroids|Blocks|Rows|Pixels?|"
    "Indices|Libraries|Elimination|Boundary|Hexagon|Board|Unit"
)
CODE = (
    *("benchmarks", "cli", "envs", "evaluator", "examples", "migrations"),
    *("server", "station", "training", "web", "worker"),
)


def texts(repository: Path) -> Iterator[Path]:
    for place in PLACES:
        found = repository / place
        yield from [found] if found.is_file() else (file for file in found.rglob("*") if file.suffix in SUFFIXES)


def uses(pattern: str, file: Path) -> Iterator[str]:
    for number, line in enumerate(file.read_text().splitlines(), start=1):
        if re.search(pattern, line, re.IGNORECASE if pattern.islower() else 0):
            yield f"{file}:{number}: {line.strip()}"


@pytest.mark.parametrize("pattern", REPLACED)
def test_replaced_words_are_not_used(repository: Path, pattern: str) -> None:
    files = [file for file in texts(repository) if file != repository / GLOSSARY]
    assert len(files) > 200
    found = [use for file in files for use in uses(pattern, file)]
    assert not found, f"write {REPLACED[pattern]!r} instead in\n" + "\n".join(found)


class Docstring(NamedTuple):
    place: str
    first_word: str
    returns_nothing: bool


def docstrings(file: Path) -> Iterator[Docstring]:
    """Yield what a file's functions begin their docstrings with."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        is_property = any(getattr(decorator, "id", "").endswith("property") for decorator in node.decorator_list)
        docstring = ast.get_docstring(node)
        if docstring and not is_property:
            returns_nothing = isinstance(node.returns, ast.Constant) and node.returns.value is None
            yield Docstring(f"{file}:{node.lineno} {node.name}", docstring.split()[0].rstrip(",.;"), returns_nothing)


def test_docstrings_of_functions_begin_with_what_they_do(repository: Path) -> None:
    files = [file for folder in CODE for file in (repository / folder).rglob("*.py")]
    found = [docstring for file in files for docstring in docstrings(file)]
    assert len(found) > 1500
    nouns = [f"{each.place}: {each.first_word}" for each in found if NO_VERBS.fullmatch(each.first_word)]
    assert not nouns, "expected a verb in the imperative first in\n" + "\n".join(nouns)
    returning = [each.place for each in found if each.returns_nothing and each.first_word == "Return"]
    assert not returning, "expected what the function does, it returns nothing, in\n" + "\n".join(returning)


def test_every_term_is_defined_once(repository: Path) -> None:
    defined = re.findall(r"^- \*\*(.+?)\*\*: ", (repository / GLOSSARY).read_text(), re.MULTILINE)
    terms = [term for names in defined for term in names.split(", ")]
    assert len(terms) > 70
    assert sorted(terms) == sorted(set(terms))
