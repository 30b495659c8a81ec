"""Writes the reference of the REST API, as Markdown, from its OpenAPI description."""

from collections.abc import Iterator, Mapping
from typing import Any

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
        lines += [f"### {name}", schema.get("description", ""), "", *_fields(schema), ""]
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
