"""benchmarks/physics.md shows the figures that were measured last, and explains what they leave open."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from physics_report.tables import TABLES, DocumentError, fill_tables


@pytest.fixture(scope="module")
def document(repository: Path) -> str:
    return (repository / "benchmarks" / "physics.md").read_text()


@pytest.fixture(scope="module")
def figures(repository: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((repository / "benchmarks" / "physics.json").read_text())
    return found


def test_every_table_is_the_one_that_the_measured_figures_make(document: str, figures: dict[str, Any]) -> None:
    assert fill_tables(document, figures) == document


def test_every_table_has_as_many_cells_in_each_row(figures: dict[str, Any]) -> None:
    for name, make in TABLES.items():
        head, *rows = make(figures)
        assert all(len(row) == len(head) for row in rows), name


def test_tables_are_made_anew_whatever_stood_there(document: str, figures: dict[str, Any]) -> None:
    emptied = re.sub(r"(<!-- table \w+ -->\n).*?(<!-- end -->)", r"\1\2", document, flags=re.DOTALL)
    assert emptied != document
    assert fill_tables(emptied, figures) == document


def test_a_document_without_one_of_the_tables_is_refused(document: str, figures: dict[str, Any]) -> None:
    with pytest.raises(DocumentError, match="ledger"):
        fill_tables(document.replace("<!-- table ledger -->", ""), figures)


def test_every_miss_and_every_unsolved_step_is_explained(document: str, figures: dict[str, Any]) -> None:
    prose = re.sub(r"<!-- table \w+ -->\n.*?<!-- end -->", "", document, flags=re.DOTALL)
    for miss in figures["misses"]:
        assert re.search(rf"episodes?\b[^.]*\b{miss['episode']}\b", prose), miss
    for run in figures["fuzz"]:
        for step in run["unsolved"]:
            assert re.search(rf"{run['task']}[^.]*\b{step['seed']}\b", prose), step
