"""Parts of pages as they were last rendered, the last ones asked for. Held by `site`."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

from markupsafe import Markup
from vitac.server.kept import Kept

if TYPE_CHECKING:
    from collections.abc import Callable

MAX_KEPT = 8192
"""Rows of boards are about 1 kB each."""


class Fragments:
    """The parts of pages that were asked for last."""

    def __init__(self, *, at_most: int = MAX_KEPT) -> None:
        self._kept: Kept[Hashable, Markup] = Kept(at_most=at_most)

    def get(self, key: Hashable, make: Callable[[], str]) -> Markup:
        """Return the part under a key, which names all that it depends on; rendered only where it is not kept."""
        return self._kept.get(key, lambda: Markup(make()))  # noqa: S704 - a rendered template, whose values are escaped
