"""Writes the reference of environments and of Python modules, as Markdown, from their source text.

Nothing is imported that would load the simulation, torch or a database.
"""

import ast
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from inspect import cleandoc
from itertools import pairwise
from pathlib import Path
from typing import Any

from vitac.envs.tasks.definition import append_tables
from vitac.envs.tasks.registry import task_definitions

PACKAGES = Path(__file__).parents[2]
"""Holds the folders that are imported as `vitac.<folder>`."""
SECTIONS = {"Args:": "Arguments", "Attributes:": "Attributes", "Returns:": "Returns", "Raises:": "Raises"}

Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def environments() -> str:
    """Return a section for each environment: its docstring, with the tables of actions and observations."""
    lines: list[str] = []
    for env_id, task in sorted(task_definitions().items()):
        module, _, name = task.environment.partition(":")
        if module.startswith("vitac."):  # those of other packages have their own documentation
            (node_of_class,) = [
                node for node in _tree(module).body if isinstance(node, ast.ClassDef) and node.name == name
            ]
            lines += [f"## {env_id}", append_tables(ast.get_docstring(node_of_class) or "", task), ""]
    return "\n".join(lines)


def modules(named: Iterable[str]) -> str:
    """Return a section for each line: `vitac.module`, or `vitac.module: Class, function` for some of it."""
    return "\n".join(line for each in named for line in _module(each))


def _tree(module: str) -> ast.Module:
    path = PACKAGES.joinpath(*module.split(".")[1:])
    return ast.parse(path.with_suffix(".py").read_bytes())


def _module(line: str) -> Iterator[str]:
    module, _, listed = line.partition(":")
    names = {name.strip() for name in listed.split(",") if name.strip()}
    tree = _tree(module)
    yield from (f"### {module}", *_docstring(ast.get_docstring(tree)))
    for node, literal in pairwise([*tree.body, ast.Pass()]):
        if isinstance(node, Definition):
            if node.name in names or (not names and not node.name.startswith("_")):
                yield from _definition(node)
        elif names & set(_targets(node)):
            yield from (f"#### {', '.join(_targets(node))}", *_docstring(_literal(literal)))


def _definition(node: Definition) -> Iterator[str]:
    yield from (f"#### {node.name}", "```python", _signature(node), "```", *_docstring(ast.get_docstring(node)))
    if isinstance(node, ast.ClassDef):
        yield from _fields(node.body)
        for method in node.body:
            if isinstance(method, Definition) and not method.name.startswith("_"):
                yield from ("```python", _signature(method), "```", *_docstring(ast.get_docstring(method)))


def _fields(body: Sequence[ast.stmt]) -> Iterator[str]:
    """List the fields that a text stands below; others are in the class's docstring."""
    for node, literal in pairwise([*body, ast.Pass()]):
        if _literal(literal) is not None and (names := _targets(node)):
            yield f"- `{', '.join(names)}`: {' '.join((_literal(literal) or '').split())}"
    yield ""


def _signature(node: Definition) -> str:
    if isinstance(node, ast.ClassDef):
        bases = ", ".join(ast.unparse(base) for base in node.bases)
        fields = [
            each for each in node.body if isinstance(each, ast.AnnAssign) and not _targets(each)[0].startswith("_")
        ]
        head = f"class {node.name}" + (f"({bases})" if bases else "") + (":" if fields else "")
        return "\n    ".join((head, *map(ast.unparse, fields)))
    if any(ast.unparse(decorator).endswith("property") for decorator in node.decorator_list):
        return f"{node.name}: {ast.unparse(node.returns) if node.returns else 'Any'}"
    returned = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    return f"{node.name}({ast.unparse(node.args)}){returned}"


def _targets(node: ast.stmt) -> list[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]


def _literal(node: ast.stmt) -> str | None:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
        return node.value.value
    return None


def _docstring(text: str | None) -> Iterator[str]:
    """Return a docstring as Markdown: its sections `Args:` and the like become lists."""
    yield ""
    for line in cleandoc(text or "").splitlines():
        entry = re.match(r" {4}([\w*, ]+): (.*)", line)
        if line in SECTIONS:
            yield from (f"{SECTIONS[line]}:", "")
        elif entry:
            yield f"- `{entry[1]}`: {entry[2]}"
        else:
            yield line.strip() if line.startswith("        ") else line.removeprefix("    ")
    yield ""


METHODS = ("get", "head", "post", "put", "patch", "delete", "options")


def rest_reference(description: Mapping[str, Any]) -> str:
    """Return a section for each route of an OpenAPI description, then one for each schema that they name."""
    lines: list[str] = []
    for path, methods in description["paths"].items():
        for method in METHODS:
            if method in methods:
                lines += [f"## {method.upper()} {path}", *_route(methods[method]), ""]
    lines += ["## Schemas", ""]
    for name, schema in sorted(description.get("components", {}).get("schemas", {}).items()):
        lines += [f"### {name}", schema.get("description", ""), "", *_rest_fields(schema), ""]
    return "\n".join(lines)


def _route(route: Mapping[str, Any]) -> Iterator[str]:
    yield route.get("description") or route["summary"]
    yield ""
    audiences = [name for needed in route.get("security", ()) for names in needed.values() for name in names]
    yield f"For {', or '.join(audiences) or 'everybody'}."
    yield ""
    if route.get("parameters"):
        yield "| parameter | in | type | meaning |"
        yield "|---|---|---|---|"
        for given in route["parameters"]:
            needed = "" if given.get("required") else ", optional"
            meaning = _line(given.get("description", ""))
            yield f"| `{given['name']}` | {given['in']}{needed} | {_type(given['schema'])} | {meaning} |"
        yield ""
    for media, content in route.get("requestBody", {}).get("content", {}).items():
        yield f"Body: `{media}`, {_type(content.get('schema', {}))}."
        yield ""
    yield "| answer | body | meaning |"
    yield "|---|---|---|"
    for status, answer in route["responses"].items():
        schemas = [content["schema"] for content in answer.get("content", {}).values() if content.get("schema")]
        bodies = ", ".join(map(_type, schemas))
        yield f"| {status} | {bodies or 'none'} | {_line(answer['description'])} |"


def _rest_fields(schema: Mapping[str, Any]) -> Iterator[str]:
    if "enum" in schema:
        yield "One of " + ", ".join(f"`{value}`" for value in schema["enum"]) + "."
    if "properties" in schema:
        yield "| field | type | meaning |"
        yield "|---|---|---|"
        for name, field in schema["properties"].items():
            yield f"| `{name}` | {_type(field)} | {_line(field.get('description', ''))} |"


def _type(schema: Mapping[str, Any]) -> str:
    """Return the type that a schema describes, as a link where it has a name."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    choices = schema.get("anyOf") or schema.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(_type(choice) for choice in choices))
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    kind = schema.get("type", "any")
    return f"{kind} ({schema['format']})" if "format" in schema else str(kind)


def _line(text: str) -> str:
    """Return a text as one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
