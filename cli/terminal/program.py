"""The command that starts this program, for hints that can be copied. Called wherever a hint names it."""

from __future__ import annotations

import os
from pathlib import Path


def program_name() -> str:
    """Return `./vitac` inside a checkout with the launcher, else `vitac`."""
    launcher = Path(__file__).resolve().parents[2] / "vitac"
    beside = launcher.is_file() and os.access(launcher, os.X_OK) and Path.cwd() == launcher.parent
    return "./vitac" if beside else "vitac"
