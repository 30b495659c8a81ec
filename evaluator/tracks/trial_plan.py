"""The order of a final's trials, drawn from the secret of its sealed list: anybody can draw it again once it is known.

A randomised complete block design (R. A. Fisher, The Design of Experiments, 1935): in each block all entries play the
same start once, in an order of chance, so that what drifts at a station from block to block is the same for all.
"""

import hmac
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class PlannedTrial:
    """Who plays which start where."""

    entry: str
    start: str
    station: str


def draw_plan(
    secret: bytes,
    *,
    entries: Iterable[str],
    starts: Iterable[str],
    stations: Sequence[str],
    control: str | None = None,
) -> list[PlannedTrial]:
    """Return all trials in their order; each station has every so many of a block, whoever's they are.

    Args:
        secret: of the sealed list.
        entries: names of what is compared.
        starts: names of the starts, each of a block.
        stations: names of the stations.
        control: entry that opens every block, one station after the other: whatever changes in its results, changed at
            a station.
    """
    others = [entry for entry in entries if entry != control]
    plan = []
    for number, start in enumerate(_shuffled(secret, "starts", starts)):
        block = ([] if control is None else [control]) + _shuffled(secret, f"start {start}", others)
        plan += [
            PlannedTrial(entry=entry, start=start, station=stations[(number + place) % len(stations)])
            for place, entry in enumerate(block)
        ]
    return plan


def _shuffled(secret: bytes, label: str, names: Iterable[str]) -> list[str]:
    """Return names in the order of HMAC-SHA256(secret, label and name)."""
    return sorted(names, key=lambda name: hmac.digest(secret, f"trial plan\n{label}\n{name}".encode(), "sha256"))
