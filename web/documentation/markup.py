"""Renders a document's Markdown as HTML for our page design, and divides it into the sections that the search finds."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup
from pydantic.fields import FieldInfo
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import find_task
from vitac.server.settings import Settings


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading and what stands below it until the next one.

    Attributes:
        level: 1 for the title of the document.
        heading: as text.
        anchor: fragment of its address.
        text: without markup.
    """

    level: int
    heading: str
    anchor: str
    text: str


@dataclass(frozen=True, kw_only=True)
class Document:
    """A rendered document.

    Attributes:
        html: all below its title.
        sections: the first one begins with the title.
    """

    html: Markup
    sections: tuple[Section, ...]

    @property
    def title(self) -> str:
        """The heading of level 1."""
        return self.sections[0].heading


def render_document(markdown: str, find_address: Callable[[str], str | None]) -> Document:
    """Render Markdown that begins with a heading of level 1.

    Args:
        markdown: CommonMark with tables.
        find_address: returns the address of the target of a link or picture; None makes the link plain text.
    """
    tokens = _PARSER.parse(markdown)
    sections = _divide(tokens)
    for token in tokens:
        _resolve_links(token.children or [], find_address)
    html = _PARSER.renderer.render(tokens[3:], _PARSER.options, {})
    return Document(html=Markup(html), sections=sections)  # noqa: S704 - our own documents


def slug(heading: str) -> str:
    """Return the anchor of a heading, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def _divide(tokens: Sequence[Token]) -> tuple[Section, ...]:
    """Give each heading its anchor, and return the sections."""
    parts: list[tuple[Token, str, list[str]]] = []
    anchors: Counter[str] = Counter()
    for token, following in pairwise(tokens):
        if token.type == "heading_open":
            anchor = slug(following.content)
            anchors[anchor] += 1
            token.attrSet("id", anchor if anchors[anchor] == 1 else f"{anchor}-{anchors[anchor] - 1}")
            parts.append((token, _text(following), []))
        elif following.type in ("inline", "fence") and token.type != "heading_open":
            parts[-1][2].append(_text(following))
    return tuple(
        Section(level=int(token.tag[1]), heading=heading, anchor=str(token.attrs["id"]), text=" ".join(texts))
        for token, heading, texts in parts
    )


def _text(token: Token) -> str:
    if token.children is None:
        return " ".join(token.content.split())
    return "".join(" " if child.type == "softbreak" else child.content for child in token.children)


def _resolve_links(tokens: Sequence[Token], find_address: Callable[[str], str | None]) -> None:
    is_link = True
    for token in tokens:
        for attribute in ("href", "src"):
            if attribute in token.attrs:
                address = find_address(str(token.attrs[attribute]))
                is_link = address is not None
                token.attrs = {**token.attrs, attribute: address} if address is not None else {}
        if token.type in ("link_open", "link_close") and not is_link:
            token.tag = "span"


def _fence(self: Any, tokens: Sequence[Token], index: int, options: object, env: object) -> str:
    """Render a block of code that the keyboard can scroll."""
    return str(type(self).fence(self, tokens, index, options, env)).replace("<pre>", '<pre tabindex="0">', 1)


def _parser() -> MarkdownIt:
    parser = MarkdownIt("commonmark").enable("table")
    parser.add_render_rule("fence", _fence)
    parser.add_render_rule("table_open", lambda *_: '<div class="wide-table" tabindex="0"><table class="table">\n')
    parser.add_render_rule("table_close", lambda *_: "</table></div>\n")
    return parser


_PARSER = _parser()


def settings() -> str:
    """Return a row for each setting of server and worker."""
    fields = Settings.model_fields.items()
    rows = ((f"VITAC_{name.upper()}", field.description or "", _default(field)) for name, field in fields)
    return _table(("variable", "meaning", "default"), rows)


def task(name: str) -> str:
    """Return the observations and the actions of a task."""
    _, definition = find_task(name)
    seen = ((row.name, f"{tuple(row.shape)} {row.dtype}", row.unit, row.meaning) for row in definition.observables)
    done = ((row.name, f"{row.scale:g} {row.unit}", row.meaning) for row in definition.actions)
    observations = _table(("observation", "shape, type", "unit", "meaning"), seen)
    return f"{observations}\n{_table(('action', 'at 1', 'meaning'), done)}"


def outcomes() -> str:
    """Return a row for each way in which an episode ends."""
    return _table(("outcome", "meaning"), ((str(outcome), outcome.sentence) for outcome in EpisodeOutcome))


def verdicts() -> str:
    """Return a row for each reason why a policy has no score."""
    return _table(("verdict", "what to do"), ((str(code), code.sentence) for code in VerdictCode))


def _default(field: FieldInfo) -> str:
    """Return a default as it is written in the environment; a description names one that is computed."""
    value = field.default.value if isinstance(field.default, Enum) else field.default
    if field.default_factory is not None:
        return "as described"
    if value in (None, ""):
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value).lower() if isinstance(value, bool) else f"{value}"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [" | ".join(head), " | ".join(["---"] * len(head))]
    lines += [" | ".join((f"`{name}`", *cells)) for name, *cells in rows]
    return "".join(f"| {line} |\n" for line in lines)
