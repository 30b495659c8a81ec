"""The plan of the tree holds: every folder is on its page, and imports are written in one way."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PRODUCT = ("cli", "envs", "evaluator", "integrations", "server", "station", "training", "web", "worker")


def rows_of_the_page(repository: Path) -> dict[str, list[str]]:
    """Return what the page says of each folder's inside: groups of folders, from top to bottom."""
    page = (repository / "docs" / "folders.md").read_text()
    table = page.partition("## Inside each folder")[2].partition("\n\nTests stand")[0]
    rows = re.findall(r"^\| `([a-z_/]+)/` \| (.+) \|$", table, re.MULTILINE)
    return {folder: row.split(" · ") for folder, row in rows}


def names_in(group: str) -> set[str]:
    return {name.partition("/")[0] for name in re.findall(r"`([a-z_0-9/]+)", group)}


def test_the_page_of_folders_names_every_folder(repository: Path) -> None:
    rows = rows_of_the_page(repository)
    assert set(rows) >= {*PRODUCT, "envs/fem", "evaluator/agent"} - {"worker"}
    for folder, groups in rows.items():
        inner = {path.parent.name for path in (repository / folder).glob("*/*.py")}
        assert inner - set().union(*map(names_in, groups)) == set(), f"name them in the row of {folder}/"


def imports_at_run_time(module: Path) -> Iterator[str]:
    """Yield the names of the modules that are imported when a module runs, not only for its types."""
    tree = ast.parse(module.read_text())
    for_types = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in set(ast.walk(tree)) - for_types:
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module or ""


def test_inside_a_top_folder_imports_are_relative(repository: Path) -> None:
    modules = [(top, module) for top in PRODUCT for module in (repository / top).rglob("*.py")]
    assert len(modules) > 500
    absolute = {
        str(module.relative_to(repository)): lines
        for top, module in modules
        if (lines := re.findall(rf"^ *(?:from|import) vitac\.{top}\b.*", module.read_text(), re.MULTILINE))
    }
    assert absolute == {}, "write `from ..folder.module import name`: a folder's own name is for the others"


def test_every_query_of_the_command_line_is_a_function_of_the_server(repository: Path) -> None:
    modules = sorted((repository / "cli").rglob("*.py"))
    assert len(modules) > 50
    queries = ("sqlalchemy", "psycopg", "vitac.server.database.models")
    found = {
        str(module): name
        for module in modules
        for name in imports_at_run_time(module)
        if name.startswith(queries) and name != "sqlalchemy.orm"  # whose Session is a type there
    }
    assert found == {}, "give the server a function for it"
