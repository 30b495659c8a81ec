"""Stages of a track as its boards show them: their titles, and links from the board of one to those of the others."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from vitac.server.views.contest import StageView

from ...site import Tab


def find_stage_title(stages: Sequence[StageView], name: str | None) -> str | None:
    """Return the title of a stage; its name where the competition's file has just lost it, None outside of stages."""
    return next((stage.title for stage in stages if stage.name == name), name)


def stage_tabs(stages: Sequence[StageView], shown: str | None, address_of: Callable[[str], str]) -> tuple[Tab, ...]:
    """Return the boards of the stages that have opened, and of the shown one; empty if there is only one.

    Args:
        stages: of the track.
        shown: name of the stage whose board is shown.
        address_of: the address of a stage's board.
    """
    now = datetime.now(UTC)
    found = [stage for stage in stages if stage.opens <= now or stage.name == shown]
    if len(found) < 2:
        return ()
    return tuple(Tab(title=stage.title, target=address_of(stage.name), current=stage.name == shown) for stage in found)
