"""Words that `docs/glossary.md` replaces do not come back: in names, messages, docstrings, pages and documents."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

SUFFIXES = {".py", ".html", ".js", ".sh", ".md", ".yaml", ".yml"}
PLACES = (
    *("cli", "web", "worker", "server", "evaluator", "examples"),
    *("envs/compilation", "envs/fem", "tests/physics"),
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


def test_every_term_is_defined_once(repository: Path) -> None:
    rows = re.findall(r"^\| ([^|]+?) \|", (repository / GLOSSARY).read_text(), re.MULTILINE)
    terms = [term for row in rows if row not in ("term", "---") for term in row.split(", ")]
    assert len(terms) > 80
    assert sorted(terms) == sorted(set(terms))
