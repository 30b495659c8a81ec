"""What functions of the physics hand around is grouped under names: none has more than six parameters."""

import ast
from collections.abc import Iterator
from pathlib import Path

import vitac.envs.fem

FOLDER = Path(vitac.envs.fem.__file__).parent
MAX_PARAMETERS = 6


def functions() -> Iterator[tuple[str, int]]:
    """Every function, with how many parameters it has beside `self`."""
    for path in sorted(FOLDER.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.Lambda):
                given = node.args
                named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
                count = len([each for each in named if each.arg not in {"self", "cls"}])
                yield f"{path.relative_to(FOLDER)}:{getattr(node, 'name', 'lambda')}", count


def test_no_function_has_more_than_six_parameters() -> None:
    found = dict(functions())
    assert len(found) > 200
    assert {name: count for name, count in found.items() if count > MAX_PARAMETERS} == {}
