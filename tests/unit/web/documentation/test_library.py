import json
from pathlib import Path

import pytest
from vitac.web.documentation.library import DOCS, Library

DESCRIPTION = {"paths": {}, "components": {"schemas": {"Gel": {"description": "A soft one."}}}}


def library(folder: Path) -> Library:
    return Library(describe_api=lambda: DESCRIPTION, folder=folder)


@pytest.fixture
def small(tmp_path: Path) -> Library:
    (tmp_path / "index.md").write_text("# Home\n\n## First\n- [Gels](parts/gels.md): soft\n- [Book](book.ipynb)\n")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "gels.md").write_text(
        "# Gels\nMarkers on rubber. See [home](../index.md), ![](../p.png), ![](../../web/static/mark.svg).\n\n"
        "## Young's modulus\nHow stiff rubber is.\n"
    )
    (tmp_path / "p.png").write_bytes(b"picture")
    cells = [("markdown", "# Book"), ("code", "print(1)")]
    notebook = {"cells": [{"cell_type": kind, "source": [source]} for kind, source in cells]}
    (tmp_path / "book.ipynb").write_text(json.dumps(notebook))
    return library(tmp_path)


def test_chapters_are_those_of_the_index(small: Library) -> None:
    (chapter,) = small.chapters
    assert (chapter.title, chapter.documents) == ("First", (("/docs/parts/gels", "Gels"), ("/docs/book", "Book")))


def test_the_index_lists_every_document() -> None:
    ours = library(DOCS)
    listed = [target.removeprefix("/docs/") for chapter in ours.chapters for target, _ in chapter.documents]
    assert sorted([*listed, "index"]) == sorted(ours.names)


def test_links_lead_to_the_addresses_of_documents_and_files(small: Library) -> None:
    html = small.document("parts/gels").html
    for address in ('href="/docs/"', 'src="/docs/p.png"', 'src="/static/mark.svg"'):
        assert address in html


def test_a_notebook_shows_its_texts_and_its_code(small: Library) -> None:
    assert small.document("book").title == "Book"
    assert "print(1)" in small.document("book").html


@pytest.mark.parametrize("name", ["p.png", "none", "../secret"])
def test_what_is_no_document_is_not_shown(small: Library, name: str) -> None:
    with pytest.raises(KeyError):
        small.document(name)


def test_search_finds_sections_with_all_words_and_prefers_headings(small: Library) -> None:
    found = small.search("Rubber gels")
    assert [(one.document, one.heading) for one in found] == [("Gels", "Gels"), ("Gels", "Young's modulus")]
    assert found[1].address == "/docs/parts/gels#youngs-modulus"
    assert found[1].excerpt == "How stiff rubber is."
    assert small.search("rubber nowhere") == []
    assert small.search(" ") == []


def test_search_prefers_what_people_wrote_to_what_is_made_of_the_code(tmp_path: Path) -> None:
    (tmp_path / "reference").mkdir()
    for name in ("reference/code", "text"):
        (tmp_path / f"{name}.md").write_text("# Gels\n\nSoft rubber.\n")
    (tmp_path / "index.md").write_text("# All\n\n- [Code](reference/code.md)\n- [Text](text.md)\n")
    assert [one.address for one in library(tmp_path).search("gels")] == ["/docs/text#gels", "/docs/reference/code#gels"]


def test_a_block_stands_for_what_the_service_says_of_itself(tmp_path: Path) -> None:
    (tmp_path / "api.md").write_text("# API\n\n```rest\n```\n")
    assert "A soft one." in library(tmp_path).document("api").html
