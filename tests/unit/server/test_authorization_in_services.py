"""Who may do something is decided by the functions of the service, not by the doors that call them."""

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

WITHOUT_DECISION = {
    "record": "notes in the audit log who did something",
    "issue_to_member": "gives whoever joins, registers or renews a token; `members` and `registration` decide",
    "take_back": "puts a withdrawn submission back; `restore` and uploading it again decide",
    "end_tokens": "ends tokens of a member who leaves or changes the password; `members` decides",
}
"""Functions that take who asks and let everybody do it, with the reason."""
DECIDING = ("require_", "may_", "organizes", "organizes_service", "reads_all", "leads_", "role", "team_id", "owns")


class Function(NamedTuple):
    place: str
    node: ast.FunctionDef | ast.AsyncFunctionDef
    principal: str  # name of the parameter

    def decides(self, deciding: set[str]) -> bool:
        """Return whether it asks the principal, or hands it to a function that does."""
        for node in ast.walk(self.node):
            if isinstance(node, ast.Attribute) and _is_name(node.value, self.principal):
                if node.attr.startswith(DECIDING):
                    return True
            elif isinstance(node, ast.Call):
                given = [*node.args, *(keyword.value for keyword in node.keywords)]
                if any(_is_name(one, self.principal) for one in given):
                    called = {_name(one) for one in (node.func, *node.args)}
                    if called & deciding:
                        return True
        return False


def _is_name(node: ast.expr, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def functions(repository: Path) -> Iterator[Function]:
    for file in sorted((repository / "server").rglob("*.py")):
        if "api" in file.relative_to(repository).parts:
            continue
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                taking = [one.arg for one in arguments if one.annotation and "Principal" in ast.unparse(one.annotation)]
                if taking:
                    yield Function(f"{file.relative_to(repository)}:{node.lineno}", node, taking[0])


def deciding_functions(by_name: Mapping[str, Sequence[Function]]) -> set[str]:
    """Return the names of functions that decide, until no more are found."""
    deciding: set[str] = set()
    while True:
        more = {name for name, all_of in by_name.items() if all(one.decides(deciding) for one in all_of)} - deciding
        if not more:
            return deciding
        deciding |= more


def test_every_function_that_takes_who_asks_decides_by_it(repository: Path) -> None:
    by_name: defaultdict[str, list[Function]] = defaultdict(list)
    for function in functions(repository):
        by_name[function.node.name].append(function)
    assert len(by_name) > 100
    deciding = deciding_functions(by_name)
    forgetting = {name for name in by_name if not name.startswith("_")} - deciding
    assert forgetting == set(WITHOUT_DECISION), {
        name: [one.place for one in by_name[name]] for name in forgetting ^ set(WITHOUT_DECISION)
    }


@pytest.mark.parametrize("door", ["server/api", "web", "cli"])
def test_no_door_decides_by_itself(repository: Path, door: str) -> None:
    found = [
        f"{file.relative_to(repository)}:{node.lineno} {node.func.attr}"
        for file in sorted((repository / door).rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_bytes()))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in {"require_organizer", "require_leader"}
    ]
    assert found == []
