"""docs/security.md shows the limits that are in force."""

import re
from dataclasses import fields
from pathlib import Path

from vitac.evaluator.agent.limits import GIB, KIB, MIB, Limits

UNITS = {"KiB": KIB, "MiB": MIB, "GiB": GIB, "s": 1, "": 1}


def documented_limits(repository: Path) -> dict[str, float]:
    text = (repository / "docs" / "security.md").read_text()
    rows = re.findall(r"^\| `(\w+)`[^|]*\| (\d+) ?(\w*) \|$", text, re.MULTILINE)
    return {name: float(number) * UNITS[unit] for name, number, unit in rows}


def test_every_limit_is_documented_with_its_value(repository: Path) -> None:
    limits = Limits()
    assert documented_limits(repository) == {field.name: getattr(limits, field.name) for field in fields(limits)}
