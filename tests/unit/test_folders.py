"""The plan of the tree holds: few modules in a folder, and a folder for each family of names."""

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

PRODUCT = ("cli", "envs", "evaluator", "server", "station", "training", "web", "worker")
CODE = (*PRODUCT, "benchmarks", "migrations", "tests")
MAX_MODULES = 20
MAX_SIBLINGS = 2
# One file for each migration, and one for each attack: data, read by one runner.
DATA = {Path("migrations/versions"), Path("tests/integration/sandbox/policies")}


def folders(repository: Path, tops: tuple[str, ...]) -> Iterator[tuple[Path, list[str]]]:
    """Yield every folder with modules, and the names of its modules and of the folders in it."""
    for top in tops:
        for folder in sorted({path.parent for path in (repository / top).rglob("*.py")}):
            modules = [path.stem for path in folder.glob("*.py") if path.stem not in ("__init__", "conftest")]
            yield folder.relative_to(repository), modules


def families(names: list[str]) -> dict[str, list[str]]:
    """Return the names by their first word, where more share it than may."""
    found: dict[str, list[str]] = defaultdict(list)
    for name in sorted(names):
        found[name.partition("_")[0]].append(name)
    return {word: members for word, members in found.items() if len(members) > MAX_SIBLINGS}


def test_no_folder_has_more_modules_than_a_page_shows(repository: Path) -> None:
    found = {folder: len(modules) for folder, modules in folders(repository, CODE)}
    assert len(found) > 100
    too_many = {str(folder): count for folder, count in found.items() if count > MAX_MODULES and folder not in DATA}
    assert not too_many, f"expected at most {MAX_MODULES} modules in a folder; make a folder of some of them"


def test_no_three_siblings_share_a_first_word(repository: Path) -> None:
    inner = defaultdict(list)
    for folder, _ in folders(repository, PRODUCT):
        inner[folder.parent].append(folder.name)
    found = {str(folder): families([*modules, *inner[folder]]) for folder, modules in folders(repository, PRODUCT)}
    assert not {folder: words for folder, words in found.items() if words}, "make a folder of each family"


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["log_a", "log_b", "check"], []),
        (["log_a", "log_b", "log"], ["log"]),
        (["log_a", "log_b", "log_c", "key_a", "key_b", "key_c"], ["key", "log"]),
        (["logs", "log_a", "log_b"], []),
    ],
)
def test_families_are_seen(names: list[str], words: list[str]) -> None:
    assert sorted(families(names)) == words


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


def test_the_page_of_folders_has_the_order_of_the_contracts(repository: Path) -> None:
    rows = rows_of_the_page(repository)
    settings = tomllib.loads((repository / "pyproject.toml").read_text())
    compared = []
    for contract in settings["tool"]["importlinter"]["contracts"]:
        (container,) = contract.get("containers", [""])
        folder = container.removeprefix("vitac.").replace(".", "/")
        if folder in rows:
            layers = [set(re.findall(r"\w+", layer)) for layer in contract["layers"]]
            inner = {path.parent.name for path in (repository / folder).glob("*/*.py")}
            in_row = [layer_of(layers, name) for group in rows[folder] for name in sorted(names_in(group) & inner)]
            assert in_row == sorted(in_row), f"expected the row of {folder}/ in the order of its contract"
            compared.append(folder)
    assert {"cli", "envs", "envs/fem", "evaluator", "server", "station", "training", "web"} <= set(compared)


def layer_of(layers: list[set[str]], name: str) -> int:
    return next(number for number, layer in enumerate(layers) if name in layer)


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
    queries = ("sqlalchemy", "psycopg", "vitac.server.db.models")
    found = {
        str(module): name
        for module in modules
        for name in imports_at_run_time(module)
        if name.startswith(queries) and name != "sqlalchemy.orm"  # whose Session is a type there
    }
    assert found == {}, "give the server a function for it"
