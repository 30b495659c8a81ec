from vitac.web.documentation.markup import Document, render_document

MARKDOWN = """# Of gels
Soft.

## `k` of a *gel*
In [its file](gel.md), not [there](../far.txt).

## k of a gel
| a | b |
|---|---|
| one | two |

```sh
./vitac demo
```
"""


def rendered() -> Document:
    return render_document(MARKDOWN, {"gel.md": "/docs/gel"}.get)


def test_sections_have_what_stands_below_their_heading() -> None:
    assert [(section.level, section.heading, section.anchor, section.text) for section in rendered().sections] == [
        (1, "Of gels", "of-gels", "Soft."),
        (2, "k of a gel", "k-of-a-gel", "In its file, not there."),
        (2, "k of a gel", "k-of-a-gel-1", "a b one two ./vitac demo"),
    ]


def test_the_title_is_left_to_the_page_and_headings_have_anchors() -> None:
    assert rendered().title == "Of gels"
    assert "<h1" not in rendered().html
    assert '<h2 id="k-of-a-gel-1">' in rendered().html


def test_links_are_those_of_the_site_and_others_are_text() -> None:
    assert '<a href="/docs/gel">its file</a>, not <span>there</span>.' in rendered().html


def test_what_is_wide_can_be_scrolled_by_the_keyboard() -> None:
    assert '<pre tabindex="0"><code class="language-sh">' in rendered().html
    assert '<div class="wide-table" tabindex="0"><table class="table">' in rendered().html
