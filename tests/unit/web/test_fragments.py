from markupsafe import Markup
from vitac.web.fragments import Fragments


def test_a_part_is_rendered_once_for_a_key() -> None:
    fragments, rendered = Fragments(), []

    def make() -> str:
        rendered.append("row")
        return f"<tr>{len(rendered)}</tr>"

    assert [fragments.get(("row", 1), make) for _ in range(3)] == ["<tr>1</tr>"] * 3
    assert fragments.get(("row", 2), make) == "<tr>2</tr>"
    assert len(rendered) == 2


def test_a_part_stands_in_a_page_as_it_was_rendered() -> None:
    part = Fragments().get("row", lambda: "<b>&lt;team&gt;</b>")
    assert Markup("<p>{}</p>").format(part) == "<p><b>&lt;team&gt;</b></p>"


def test_two_sites_share_no_parts() -> None:
    assert Fragments().get("row", lambda: "one") == "one"
    assert Fragments().get("row", lambda: "two") == "two"
