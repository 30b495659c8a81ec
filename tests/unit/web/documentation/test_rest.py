from typing import Any

from vitac.web.documentation.reference import rest_reference

ITEM = {"$ref": "#/components/schemas/ItemView"}
DESCRIPTION: dict[str, Any] = {
    "paths": {
        "/items/{id}": {
            "get": {
                "summary": "Get",
                "description": "Return one item.",
                "security": [{"HTTPBearer": ["readers", "everybody"]}],
                "parameters": [
                    {"name": "id", "in": "path", "required": True, "schema": {"type": "string", "format": "uuid"}},
                    {"name": "kind", "in": "query", "schema": {"anyOf": [{"enum": ["a", "b"]}, {"type": "null"}]},
                     "description": "One\n of | two."},
                ],
                "responses": {
                    "200": {"description": "It.", "content": {"application/json": {"schema": ITEM}}},
                    "204": {"description": "Nothing."},
                },
            },
            "post": {
                "summary": "Change it.",
                "requestBody": {"content": {"application/json": {"schema": {"type": "array", "items": ITEM}}}},
                "responses": {"201": {"description": "Done.", "content": {"text/plain": {}}}},
            },
        }
    },
    "components": {
        "schemas": {
            "ItemView": {
                "description": "One item.",
                "properties": {"n": {"type": "integer", "description": "How many."}, "any": {}},
            },
            "Colour": {"enum": ["red", "blue"]},
        }
    },
}  # fmt: skip


def lines() -> list[str]:
    return rest_reference(DESCRIPTION).splitlines()


SHOWN = [
    "## GET /items/{id}",
    "Return one item.",
    "For readers, or everybody.",
    "| `id` | path | string (uuid) |  |",
    "| `kind` | query, optional | `a`, `b` or null | One of \\| two. |",
    "| 200 | [ItemView](#itemview) | It. |",
    "| 204 | none | Nothing. |",
    "## POST /items/{id}",
    "Change it.",
    "For everybody.",
    "Body: `application/json`, list of [ItemView](#itemview).",
    "| 201 | none | Done. |",
    "### ItemView",
    "One item.",
    "| `n` | integer | How many. |",
    "| `any` | any |  |",
    "One of `red`, `blue`.",
]


def test_routes_and_schemas_become_markdown() -> None:
    assert [line for line in SHOWN if line not in lines()] == []


def test_schemas_come_after_all_routes_and_in_order() -> None:
    headings = [line for line in lines() if line.startswith("#")]
    assert headings == ["## GET /items/{id}", "## POST /items/{id}", "## Schemas", "### Colour", "### ItemView"]
