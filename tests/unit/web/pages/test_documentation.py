import re
from collections.abc import Iterator

import pytest
from asgi_browser import AsgiBrowser
from vitac.web.documentation.library import DOCS


def test_every_page_leads_to_the_documentation(browser: AsgiBrowser) -> None:
    for path in ("/", "/tracks/track_1/rules", "/register", "/docs/glossary"):
        assert '<a href="/docs/">Documentation</a>' in browser.get(path).text


def test_a_document_is_a_page_of_the_arena(browser: AsgiBrowser) -> None:
    answer = browser.get("/docs/start/participant")
    assert answer.status_code == 200
    assert "<title>Take part: from nothing to a score · ViTac Arena</title>" in answer.text
    assert '<a href="/docs/submissions">' in answer.text
    assert '<a href="/docs/start/participant" aria-current="page">Take part</a>' in answer.text


def test_files_of_documents_are_served(browser: AsgiBrowser) -> None:
    picture = browser.get("/docs/pictures/belief.png")
    assert (picture.status_code, picture.headers["content-type"]) == (200, "image/png")
    assert picture.content == (DOCS / "pictures" / "belief.png").read_bytes()


@pytest.mark.parametrize("path", ["/docs/none", "/docs/../README.md", "/docs/%2e%2e/README.md", "/docs/start"])
def test_nothing_but_the_documentation_is_served(browser: AsgiBrowser, path: str) -> None:
    assert browser.get(path).status_code == 404


@pytest.mark.slow
def test_search_leads_to_the_section(browser: AsgiBrowser) -> None:
    found = browser.get("/docs/search?q=result+hash").text
    assert re.search(r"\d+ sections with “result hash”", found)
    assert 'href="/docs/glossary#' in found
    assert "No sections with “&lt;script&gt;”" in browser.get("/docs/search?q=<script>").text


def targets(html: str) -> Iterator[str]:
    article = html.partition("<article")[2].partition("</article>")[0]
    yield from (target for target in re.findall(r'(?:href|src)="([/#][^"]*)"', article))


def test_every_link_of_every_document_leads_somewhere(browser: AsgiBrowser) -> None:
    pages: dict[str, str] = {}

    def page(path: str) -> str:
        if path not in pages:
            answer = browser.get(path)
            assert answer.status_code == 200, path
            pages[path] = answer.text if answer.headers["content-type"].startswith("text/html") else ""
        return pages[path]

    listed = re.findall(r'href="(/docs/[^"#]*)"', page("/docs/"))
    assert len(listed) > 35
    for path in dict.fromkeys(listed):
        for target in targets(page(path)):
            address, _, anchor = target.partition("#")
            there = page(address or path)
            assert not anchor or f'id="{anchor}"' in there, f"{path}: {target}"
