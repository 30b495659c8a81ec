"""Writes operations.json: the operations of the API, from which verbs of commands are made; run it after a change.

`.venv/bin/python setup/describe_api.py`. Without the file each command would load the whole application first, for two
seconds.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vitac.server.api.app import API_PREFIX, create_app
from vitac.server.settings import load_settings

TARGET = Path(__file__).parents[1] / "cli" / "client" / "operations.json"


def document() -> str:
    """Return the text of operations.json: for `METHOD /path` what it does and its fields."""
    api = create_app(load_settings()).openapi()
    found = {
        f"{method.upper()} {path.removeprefix(API_PREFIX)}": {
            "text": operation.get("description", ""),
            "fields": list(_fields(operation, api["components"]["schemas"])),
        }
        for path, operations in api["paths"].items()
        for method, operation in operations.items()
        if path.startswith(API_PREFIX)
    }
    lines = (f"{json.dumps(name)}: {json.dumps(found[name], ensure_ascii=False)}" for name in sorted(found))
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _fields(operation: dict[str, Any], schemas: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for parameter in operation.get("parameters", ()):
        if parameter["in"] != "header":
            yield {
                "name": parameter["name"],
                "place": parameter["in"],
                "needed": parameter.get("required", False),
                **_kind(parameter["schema"], schemas, parameter.get("description")),
            }
    content = operation.get("requestBody", {}).get("content", {}).get("application/json")
    body = _resolved(content["schema"], schemas) if content else {}
    for name, schema in body.get("properties", {}).items():
        yield {
            "name": name,
            "place": "body",
            "needed": name in body.get("required", ()),
            **_kind(schema, schemas, schema.get("description")),
        }


def _kind(schema: dict[str, Any], schemas: dict[str, Any], help_text: str | None) -> dict[str, Any]:
    """Return type, limits and help of a field, without what is not said."""
    options = [_resolved(option, schemas) for option in schema.get("anyOf", (schema,))]
    (known, *_) = [option for option in options if option.get("type") != "null"]
    many = known.get("type") == "array"
    single = _resolved(known["items"], schemas) if many else known
    said = {
        "type": single.get("format") if single.get("format") == "uuid" else single.get("type", "object"),
        "many": many or None,
        "choices": single.get("enum") or ([single["const"]] if "const" in single else None),
        "min": single.get("minimum"),
        "max": single.get("maximum"),
        "default": schema.get("default") if not many else None,
        "help": help_text,
    }
    return {name: value for name, value in said.items() if value is not None}


def _resolved(schema: dict[str, Any], schemas: dict[str, Any]) -> dict[str, Any]:
    return schemas[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else schema


if __name__ == "__main__":
    TARGET.write_text(document(), encoding="utf-8")
