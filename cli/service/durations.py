"""Durations as a command line takes them: a number of seconds, or of minutes, hours or days with their letter."""

import re

import typer

_UNITS_S = {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86400}


def parse_duration_s(text: str) -> float:
    """Return a duration [s].

    Raises:
        BadParameter: it is none.
    """
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smhd]?)", text.strip())
    if match is None:
        raise typer.BadParameter(f"expected a duration such as 60, 90s, 15m, 4h or 1d, got {text!r}")
    return float(match[1]) * _UNITS_S[match[2]]
