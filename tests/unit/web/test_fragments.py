import asyncio

import pytest
from markupsafe import Markup
from vitac.web import fragments as module
from vitac.web.fragments import Fragments, Recent


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


def test_what_many_ask_for_is_read_again_after_a_while_and_not_kept_where_reading_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 100.0
    reads: list[int] = []
    monkeypatch.setattr(module, "monotonic", lambda: now)
    recent: Recent[int] = Recent(kept_s=5.0)

    async def read() -> int:
        if now == 105.0 and len(reads) == 1:
            reads.append(0)
            raise OSError("gone")
        reads.append(len(reads))
        return len(reads)

    assert [asyncio.run(recent.get(read)) for _ in range(3)] == [1, 1, 1]
    now = 105.0
    with pytest.raises(OSError, match="gone"):
        asyncio.run(recent.get(read))
    assert asyncio.run(recent.get(read)) == 3
