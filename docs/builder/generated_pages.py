"""Writes the parts of the reference that the code itself says: REST routes and environments.

They are Markdown in `docs/generated/`, which pages of the reference include. Others have docstrings by autodoc.
"""

import inspect
import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import animations
from sphinx.application import Sphinx

FOLDER = "generated"
METHODS = ("get", "head", "post", "put", "patch", "delete", "options")
SOURCE_NOTE = re.compile(r"\s\(challenge-facts\s[^)]*\)|\s\[D\d+\]")
"""Where a number of the challenge is from, in a list of facts that readers of the site do not have."""


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages before Sphinx reads its sources."""
    app.connect("builder-inited", _write)
    app.connect("autodoc-process-docstring", _for_readers)
    return {"parallel_read_safe": True}


def _for_readers(_app: Sphinx, _what: str, _name: str, _thing: object, _options: object, lines: list[str]) -> None:
    lines[:] = for_readers("\n".join(lines)).split("\n")


def for_readers(docstring: str) -> str:
    """Return a docstring without notes on sources, its magnitudes `|x|` as text instead of reStructuredText's names."""
    return re.sub(r"\|(\w+)\|", r"\\|\1\\|", SOURCE_NOTE.sub("", docstring))


def _write(app: Sphinx) -> None:
    from vitac.server.api.app import create_app
    from vitac.server.settings import load_settings

    folder = Path(app.srcdir) / FOLDER
    folder.mkdir(exist_ok=True)
    description = create_app(load_settings(database_url="postgresql:///unused")).openapi()
    (folder / "rest.md").write_text(rest_reference(description))
    (pictures,) = (folder / "animations").iterdir()
    animated = {env_id: animations.element(env_id, pictures, above="..") for env_id in animations.SHOWN}
    (folder / "environments.md").write_text(environments_reference(animated))


def environments_reference(animated: Mapping[str, str]) -> str:
    """Return a section for each registered environment: its animation, then its docstring."""
    from vitac.envs import ENVIRONMENTS

    lines: list[str] = []
    for name, place in sorted(ENVIRONMENTS.items()):
        module, _, attribute = place.partition(":")
        docstring = inspect.getdoc(getattr(import_module(module), attribute)) or ""
        lines += [f"## {name}", animated[name], "", SOURCE_NOTE.sub("", docstring), ""]
    return "\n".join(lines)


def rest_reference(description: Mapping[str, Any]) -> str:
    """Return a section for each route of an OpenAPI description, then one for each schema that they name."""
    lines: list[str] = []
    for path, methods in description["paths"].items():
        for method in METHODS:
            if method in methods:
                lines += [f"## {method.upper()} {path}", *_route(methods[method]), ""]
    lines += ["## Schemas", ""]
    for name, schema in sorted(description["components"]["schemas"].items()):
        lines += [f"### {name}", schema.get("description", ""), "", *_fields(schema), ""]
    return "\n".join(lines)


def _route(route: Mapping[str, Any]) -> Iterator[str]:
    yield route.get("description") or route["summary"]
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


def _fields(schema: Mapping[str, Any]) -> Iterator[str]:
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
