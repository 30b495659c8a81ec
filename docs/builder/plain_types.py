"""Writes the types of checked fields as a reader says them: `int of 1 to 100` for pydantic's annotated `int`."""

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

ANNOTATED = "Annotated["
TYPE_FIELDS = ("type", "rtype")


def setup(app: Sphinx) -> dict[str, Any]:
    """Rewrite the types of each object after autodoc has added them."""
    app.connect("object-description-transform", _rewrite, priority=600)
    return {"parallel_read_safe": True}


def _rewrite(_app: Sphinx, domain: str, _kind: str, content: addnodes.desc_content) -> None:
    if domain != "py":
        return
    for field in list(content.findall(nodes.field)):
        if field[0].astext().split()[0] in TYPE_FIELDS and ANNOTATED in field[1].astext():
            _replace(field[1], nodes.paragraph("", plain_type(field[1].astext())))
    for signature in content.parent.findall(addnodes.desc_signature):
        for annotation in signature.findall(addnodes.desc_annotation):
            if ANNOTATED in annotation.astext():
                _replace(annotation, nodes.Text(plain_type(annotation.astext())))


def _replace(parent: nodes.Element, child: nodes.Node) -> None:
    parent.clear()
    parent += child


def plain_type(text: str) -> str:
    """Return a type with each annotated one as its own type and bounds."""
    start = text.find(ANNOTATED)
    if start < 0:
        return text
    inner, end = _bracketed(text, start + len(ANNOTATED))
    kind, conditions = _first_argument(inner)
    return text[:start] + plain_type(kind) + _bounds(conditions) + plain_type(text[end:])


def _bracketed(text: str, start: int) -> tuple[str, int]:
    """Return what stands before the bracket that closes one opened before `start`, and where the text goes on."""
    depth = 1
    for place in range(start, len(text)):
        depth += (text[place] == "[") - (text[place] == "]")
        if depth == 0:
            return text[start:place], place + 1
    return text[start:], len(text)


def _first_argument(inner: str) -> tuple[str, str]:
    """Return the first of several arguments, whose own brackets may hold commas, and the others."""
    depth = 0
    for place, character in enumerate(inner):
        depth += (character in "[(") - (character in ")]")
        if depth == 0 and character == ",":
            return inner[:place], inner[place:]
    return inner, ""


def _bounds(conditions: str) -> str:
    found = dict(re.findall(r"\b(Ge|Gt|Le|Lt)\(\w+=(-?[\d.]+(?:e[+-]?\d+)?)\)", conditions))
    if "Ge" in found and "Le" in found:
        return f" of {found['Ge']} to {found['Le']}"
    words = {"Ge": "at least", "Gt": "above", "Le": "at most", "Lt": "below"}
    told = [f"{word} {found[name]}" for name, word in words.items() if name in found]
    return f" {' and '.join(told)}" if told else ""
