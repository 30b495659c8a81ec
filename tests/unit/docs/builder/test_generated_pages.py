"""docs/builder/generated_pages.py: what the code says of itself, as Markdown."""

from typing import Any

import pytest
from generated_pages import environments_reference, for_readers, rest_reference
from vitac.envs import ENVIRONMENTS

ITEM = {"$ref": "#/components/schemas/ItemView"}
DESCRIPTION: dict[str, Any] = {
    "paths": {
        "/items/{id}": {
            "get": {
                "summary": "Get",
                "description": "Return one item.",
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


@pytest.mark.parametrize(
    "line",
    [
        "## GET /items/{id}",
        "Return one item.",
        "| `id` | path | string (uuid) |  |",
        "| `kind` | query, optional | `a`, `b` or null | One of \\| two. |",
        "| 200 | [ItemView](#itemview) | It. |",
        "| 204 | none | Nothing. |",
        "## POST /items/{id}",
        "Change it.",
        "Body: `application/json`, list of [ItemView](#itemview).",
        "| 201 | none | Done. |",
        "### ItemView",
        "One item.",
        "| `n` | integer | How many. |",
        "| `any` | any |  |",
        "One of `red`, `blue`.",
    ],
)
def test_routes_and_schemas_become_markdown(line: str) -> None:
    assert line in lines()


def test_schemas_come_after_all_routes_and_in_order() -> None:
    headings = [line for line in lines() if line.startswith("#")]
    assert headings == ["## GET /items/{id}", "## POST /items/{id}", "## Schemas", "### Colour", "### ItemView"]


def test_every_registered_environment_has_its_docstring() -> None:
    text = environments_reference({name: f"<img alt='{name} moves'>" for name in ENVIRONMENTS})
    assert len(ENVIRONMENTS) >= 3
    for name in ENVIRONMENTS:
        section = text.split(f"## {name}\n")[1].split("\n## ")[0]
        assert section.startswith(f"<img alt='{name} moves'>\n\n")
        assert "Observation space" in section


@pytest.mark.parametrize(
    ("docstring", "shown"),
    [
        ("Ranges of the grid (challenge-facts 4.2); noisy.", "Ranges of the grid; noisy."),
        ("The defaults are the evaluation's (challenge-facts\n3, 7).", "The defaults are the evaluation's."),
        ("Clipped (the 2025 code does not clip [D4]).", "Clipped (the 2025 code does not clip)."),
        ("Offset [x, y]; the diagonal [D, D].", "Offset [x, y]; the diagonal [D, D]."),
        ("Largest |x| and |y|, a | b.", r"Largest \|x\| and \|y\|, a | b."),
    ],
)
def test_readers_are_not_sent_to_a_list_that_they_do_not_have(docstring: str, shown: str) -> None:
    assert for_readers(docstring) == shown


def test_environments_name_no_list_of_facts() -> None:
    text = environments_reference(dict.fromkeys(ENVIRONMENTS, ""))
    assert "the 2025 code does not clip)" in text
    assert "challenge-facts" not in text
