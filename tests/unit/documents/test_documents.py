"""What the documents say exists: files that they link to, commands that they show, settings that they name."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from vitac.cli.main import NOUNS
from vitac.server.settings import Quotas, Settings

READERS = ("cli/**/*.py", "evaluator/**/*.py", "envs/**/*.py", "setup/*.sh", "tests/conftest.py", "docker-compose.yml")


def documents(repository: Path) -> Iterator[Path]:
    yield from sorted(repository.glob("*.md"))
    for folder in ("docs", "benchmarks"):
        yield from sorted((repository / folder).rglob("*.md"))


def headings(document: Path) -> set[str]:
    """The anchors of a document's headings, as the usual renderers make them."""
    titles = re.findall(r"^#+ (.+)$", document.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_the_changelog_says_each_thing_once(repository: Path) -> None:
    """Lines that two changes add are merged by keeping both, which brings back what one of them had moved."""
    lines = (repository / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    begins = Counter(line[:40] for line in lines if line.startswith("- "))
    assert len(begins) > 20
    assert {begin for begin, times in begins.items() if times > 1} == set()


def test_links_lead_somewhere(repository: Path) -> None:
    broken = []
    for document in documents(repository):
        for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
            if "://" in target:
                continue
            name, _, anchor = target.partition("#")
            file = (document.parent / name).resolve() if name else document
            if not file.exists() or (anchor and anchor not in headings(file)):
                broken.append(f"{document.relative_to(repository)}: {target}")
    assert broken == []


def test_documents_of_the_site_link_to_no_document_outside_it(repository: Path) -> None:
    """The site is built of `docs` alone and treats such a link as broken."""
    site = (repository / "docs").resolve()
    outside = []
    for document in site.rglob("*.md"):
        for target in re.findall(r"\]\(([^)#\s]+\.(?:md|ipynb))[^)]*\)", document.read_text()):
            if "://" not in target and not (document.parent / target).resolve().is_relative_to(site):
                outside.append(f"{document.relative_to(site)}: {target}")
    assert outside == []


def test_columns_of_tables_have_headings(repository: Path) -> None:
    """Screen readers say the heading of a column before each cell."""
    heads = [
        (document.name, head)
        for document in documents(repository)
        for head in re.findall(r"^\|(.+)\|\n\|[ :|-]+\|$", document.read_text(), re.MULTILINE)
    ]
    assert len(heads) > 50
    assert [(name, head) for name, head in heads if not all(cell.strip() for cell in head.split("|"))] == []


def test_commands_shown_exist(repository: Path) -> None:
    known = {noun.name for noun in NOUNS}
    unknown = []
    for document in documents(repository):
        for noun in re.findall(r"(?:^|`|\./)vitac ([a-z]+)", document.read_text(), re.MULTILINE):
            if noun not in known | {"test"}:
                unknown.append(f"{document.relative_to(repository)}: vitac {noun}")
    assert unknown == []


def test_settings_named_exist(repository: Path) -> None:
    known = {f"VITAC_{name.upper()}" for name in Settings.model_fields}
    known |= {f"VITAC_QUOTAS__{name.upper()}" for name in Quotas.model_fields}
    for pattern in READERS:
        for file in repository.glob(pattern):
            known |= set(re.findall(r"\bVITAC_[A-Z_]+\b", file.read_text()))
    unknown = []
    for document in documents(repository):
        for variable in re.findall(r"\bVITAC_[A-Z_]+\b", document.read_text()):
            if variable not in known:
                unknown.append(f"{document.relative_to(repository)}: {variable}")
    assert unknown == []


@pytest.mark.parametrize("folder", ["cli", "envs", "evaluator", "migrations", "server", "web", "worker"])
def test_architecture_places_every_folder(repository: Path, folder: str) -> None:
    assert f"| `{folder}/` | `vitac.{folder}` |" in (repository / "docs" / "architecture.md").read_text()
