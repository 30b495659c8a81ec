"""Parts of pages as they were last rendered, the last ones asked for. Held by `site`."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING

from markupsafe import Markup

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

MAX_KEPT = 8192
"""Rows of boards are about 1 kB each."""


class Fragments:
    """The parts of pages that were asked for last."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, Markup] = OrderedDict()

    def get(self, key: Hashable, make: Callable[[], str]) -> Markup:
        """Return the part under a key, which names all that it depends on; rendered only where it is not kept."""
        found = self._kept.pop(key, None)
        if found is None:
            found = Markup(make())  # noqa: S704 - a rendered template, whose values are escaped
        self._kept[key] = found
        while len(self._kept) > MAX_KEPT:
            self._kept.popitem(last=False)
        return found
