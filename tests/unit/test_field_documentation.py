"""One way to document the fields of a dataclass: under `Attributes:` of its docstring (CONTRIBUTING.md)."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDERS = ("cli", "web", "server", "worker", "envs", "evaluator/logs", "station")


def dataclasses_in(folder: Path) -> Iterator[tuple[Path, ast.ClassDef]]:
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ClassDef) and any("dataclass" in ast.unparse(it) for it in node.decorator_list):
                yield file, node


def is_sentence(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def described_attributes(node: ast.ClassDef) -> set[str]:
    _, _, listed = (ast.get_docstring(node) or "").partition("\nAttributes:\n")
    lines = [line for line in listed.split("\n\n")[0].splitlines() if line.startswith("    ") and line[4:5].strip()]
    return {name.strip(" *`") for line in lines for name in line.partition(":")[0].split(",")}


@pytest.mark.parametrize("folder", FOLDERS)
def test_fields_are_not_described_below_themselves(repository: Path, folder: str) -> None:
    found = list(dataclasses_in(repository / folder))
    assert found
    below = [
        f"{file.relative_to(repository)}: {node.name}.{ast.unparse(field).partition(':')[0]}"
        for file, node in found
        for field, after in zip(node.body, node.body[1:], strict=False)
        if isinstance(field, ast.AnnAssign) and is_sentence(after)
    ]
    assert below == []


def members(node: ast.ClassDef) -> set[str]:
    fields = {ast.unparse(item.target) for item in node.body if isinstance(item, ast.AnnAssign)}
    return fields | {item.name for item in node.body if isinstance(item, ast.FunctionDef)}


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_described_attribute_exists(repository: Path, folder: str) -> None:
    unknown = [
        f"{file.relative_to(repository)}: {node.name}.{name}"
        for file, node in dataclasses_in(repository / folder)
        for name in described_attributes(node) - members(node)
    ]
    assert unknown == []
