"""All documents of `docs/`, found by name and by words. Called by the pages at `/docs`."""

import json
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from . import markup, reference
from .markup import Document, Section, render_document

DOCS = Path(__file__).parents[2] / "docs"
ADDRESS = "/docs/"
INDEX = "index"
GENERATED = re.compile(
    r"^```(python-reference|rest|task|environments|settings|outcomes|verdicts)\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
"""Blocks that stand for what the code says of itself."""
TABLES = {
    "environments": reference.environments,
    "settings": markup.settings,
    "outcomes": markup.outcomes,
    "verdicts": markup.verdicts,
}
REFERENCE = "reference/"
"""Begins the names of documents that are made of the code; searches prefer those that people wrote."""
MAX_FOUND = 20
EXCERPT = 160
"""Characters before and after the first word that was found."""


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """Documents that the index lists under one heading, as addresses and titles."""

    title: str
    documents: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class Found:
    """A section that has all words of a search."""

    document: str
    heading: str
    address: str
    excerpt: str


@dataclass(frozen=True, kw_only=True)
class Library:
    """The documents, each rendered when it is first needed.

    Attributes:
        describe_api: returns the OpenAPI description of the service.
        folder: with the documents.
    """

    describe_api: Callable[[], Mapping[str, Any]]
    folder: Path = DOCS
    _rendered: dict[str, Document] = field(default_factory=dict, init=False)

    @cached_property
    def files(self) -> Mapping[str, Path]:
        """All files by their path in the folder; documents among them without their suffix."""
        paths = sorted(path for path in self.folder.rglob("*") if path.is_file())
        return {strip_suffix(path.relative_to(self.folder).as_posix()): path for path in paths}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of all documents."""
        return tuple(name for name, path in self.files.items() if is_document(path.name))

    @cached_property
    def chapters(self) -> tuple[Chapter, ...]:
        """The documents in the order of the index."""
        parts = re.split(r"^## (.+)$", self.files[INDEX].read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
        return tuple(
            Chapter(
                title=title,
                documents=tuple(
                    (ADDRESS + strip_suffix(target), text)
                    for text, target in re.findall(r"^- \[(.+?)\]\((.+?)\)", part, re.M)
                ),
            )
            for title, part in zip(parts[::2], parts[1::2], strict=True)
        )

    def document(self, name: str) -> Document:
        """Return a rendered document.

        Raises:
            KeyError: there is none of this name.
        """
        if name not in self._rendered:
            path = self.files[name]
            if not is_document(path.name):
                raise KeyError(name)
            markdown = read_markdown(path)
            markdown = GENERATED.sub(lambda block: self._generate(block[1], block[2]), markdown)
            self._rendered[name] = render_document(markdown, lambda target: self._address(name, target))
        return self._rendered[name]

    def search(self, query: str) -> list[Found]:
        """Return the sections that have all words of a query, the best first."""
        words = query.lower().split()
        if not words:
            return []
        scored = [
            (_score(words, document.title, section) / (2 if name.startswith(REFERENCE) else 1), name, section)
            for name in self.names
            for document in [self.document(name)]
            for section in document.sections
        ]
        scored.sort(key=lambda entry: -entry[0])
        return [
            Found(
                document=self.document(name).title,
                heading=section.heading,
                address=self._address(INDEX, f"{name}.md#{section.anchor}") or ADDRESS,
                excerpt=_excerpt(words, section.text),
            )
            for score, name, section in scored[:MAX_FOUND]
            if score
        ]

    def _generate(self, block: str, lines: str) -> str:
        if block == "rest":
            return reference.rest_reference(self.describe_api())
        if block == "task":
            return markup.task(lines.strip())
        return TABLES[block]() if block in TABLES else reference.modules(lines.splitlines())

    def _address(self, name: str, target: str) -> str | None:
        """Return the address of what a document links to; None for files that only the repository has."""
        if "://" in target or target.startswith("#"):
            return target
        path, hash_, anchor = target.partition("#")
        address = strip_suffix(posixpath.normpath(posixpath.join(posixpath.dirname(name), path)))
        if address.startswith("../web/static/"):
            return address.removeprefix("../web")
        if address not in self.files:
            return None
        return ADDRESS + ("" if address == INDEX else address) + hash_ + anchor


def is_document(path: str) -> bool:
    """Return whether a file is shown as a page."""
    return path.endswith((".md", ".ipynb"))


def strip_suffix(path: str) -> str:
    """Return a path without the suffix of documents."""
    return path.removesuffix(".md").removesuffix(".ipynb")


def read_markdown(path: Path) -> str:
    """Return the Markdown of a document; of a notebook its texts and its code."""
    text = path.read_text(encoding="utf-8")
    return "\n\n".join(_cells(json.loads(text))) if path.suffix == ".ipynb" else text


def _cells(notebook: Mapping[str, Any]) -> Iterator[str]:
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        yield source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```"


def _score(words: list[str], title: str, section: Section) -> int:
    """Return how well a section fits: 0 unless it has each word; words in headings count most."""
    heading, text = f"{title} {section.heading}".lower(), section.text.lower()
    if not all(word in heading or word in text for word in words):
        return 0
    in_section = section.heading.lower()
    return 1 + sum(10 * (word in in_section) + 5 * (word in heading) + min(text.count(word), 4) for word in words)


def _excerpt(words: list[str], text: str) -> str:
    places = [place for word in words if (place := text.lower().find(word)) >= 0]
    start = max(0, min(places, default=0) - EXCERPT)
    begin = text.find(" ", start) + 1 if start else 0
    end = text.find(" ", begin + 2 * EXCERPT)
    return ("… " if begin else "") + (text[begin:] if end < 0 else f"{text[begin:end]} …")
