"""The evaluation scripts of 2025 and 2024: their episode lists, limits and rules."""

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from itertools import product
from math import isclose
from typing import Any

from pydantic import PositiveFloat, PositiveInt

from ...strict_model import StrictModel, parse_yaml

PRINTED_MM = 2e-5
"""Largest difference between printed values and our arithmetic [mm, degrees, reward]."""


def is_printed(shown: Sequence[float], expected: Sequence[float]) -> bool:
    """Return whether a log may print these numbers so."""
    return len(shown) == len(expected) and all(
        isclose(a, b, abs_tol=PRINTED_MM) for a, b in zip(shown, expected, strict=True)
    )


class PegRules(StrictModel):
    """How a peg task judges an env step; lengths in mm, angles in degrees."""

    action_scale: tuple[float, ...]
    descent_per_step_mm: float
    """Automatic descent; 0 where the action moves the peg in z."""
    surface_limit_m: float = 0.0015
    offset_limit: tuple[float, ...]
    depth_mm: float
    """Every bottom vertex of the peg must be lower than this below the hole's top."""
    commanded_depth_mm: float = 0.0
    success_limit: tuple[float, ...] = ()
    step_penalty: float
    final_reward: float


class PrintedStart(StrictModel):
    """One start of a list, as the log prints it."""

    shape_index: int
    shape: str
    repeat_index: int
    offset_index: int
    offset: tuple[float, ...]
    listed_offset: tuple[float, ...]
    """The start as the script's own list has it."""
    true_offset: tuple[float, ...]
    """The start as our environment counts it: with a hole's top too high in the books, the peg began higher above the
    real one."""

    @property
    def part(self) -> str:
        """Return the held part; in the vision track the log adds the side of its hole."""
        return self.shape.partition("(")[0]


class Script(StrictModel):
    """One of the evaluation scripts that wrote text logs."""

    name: str
    track: str
    task: str
    md5: tuple[str, ...]
    """MD5 of each published version, the newest first; none where logs have no MD5, as in 2024."""
    marked_by: str
    """A key of the environment that only this script prints, among those with or those without an MD5."""
    environment: dict[str, Any]
    """The official evaluation's values."""
    action_size: PositiveInt
    max_steps: PositiveInt
    repeats: PositiveInt
    loops: tuple[str, ...]
    shapes: tuple[str, ...]
    offsets: tuple[tuple[float, ...], ...]
    logs_offsets: bool
    """Whether start and offset are logged."""
    logs_infos: bool = True
    """Whether info and reward are logged beside the offset."""
    peg: PegRules | None = None
    hole_tops_mm: tuple[PositiveFloat, ...] = ()
    """Vision track only: heights of the hole's top in the books; the published logs have the first, whose geometry had
    the last all the same."""

    def starts(self, hole_top_mm: float | None = None) -> list[PrintedStart]:
        """Return the list, in the order of the script's loops.

        Args:
            hole_top_mm: which of `hole_tops_mm`; the first by default.
        """
        lengths = {"repeat": self.repeats, "offset": len(self.offsets), "shape": len(self.shapes)}
        printed = []
        for values in product(*(range(lengths[loop]) for loop in self.loops)):
            index = dict(zip(self.loops, values, strict=True))
            offset = self.offsets[index["offset"]]
            shape = index["shape"] if "shape" in index else int(offset[-1])
            printed.append(
                PrintedStart(
                    shape_index=shape,
                    shape=self.shapes[shape],
                    repeat_index=index["repeat"],
                    offset_index=index["offset"],
                    offset=self._shown(offset, hole_top_mm),
                    listed_offset=offset,
                    true_offset=self._true(offset, hole_top_mm),
                )
            )
        return printed

    def era(self, hole_top_mm: float | None) -> str | None:
        """Return in which books the hole's top had this height; None where there is one era only."""
        if hole_top_mm is None:
            return None
        real_mm = self.hole_tops_mm[-1]
        since = "since" if hole_top_mm == real_mm else "before"
        return f"{since} 2025-03-14: rim {hole_top_mm:g} mm in the books, {real_mm:g} mm in the geometry"

    def find_start(self, shape: str, shown_offset: tuple[float, ...]) -> PrintedStart | None:
        """Return the start of the list that a log shows so, in whichever era; None where there is none."""
        for top_mm in self.hole_tops_mm or (None,):
            for start in self.starts(top_mm):
                if start.shape == shape and is_printed(shown_offset, start.offset):
                    return start
        return None

    def _true(self, offset: tuple[float, ...], hole_top_mm: float | None) -> tuple[float, ...]:
        if not self.hole_tops_mm:
            return offset
        x, y, theta, z, left = offset
        return x, y, theta, z + (hole_top_mm or self.hole_tops_mm[0]) - self.hole_tops_mm[-1], left

    def _shown(self, offset: tuple[float, ...], hole_top_mm: float | None) -> tuple[float, ...]:
        """Return the start as the log shows it; in the vision track relative to the target."""
        if not self.hole_tops_mm:
            return offset
        x, y, theta, z, left = offset
        return x, y + 22.625 - (45.25 if left else 0.0), theta, z + (hole_top_mm or self.hole_tops_mm[0]) - 6.9


class _Scripts(StrictModel):
    scripts: tuple[Script, ...]


@cache
def all_scripts() -> tuple[Script, ...]:
    """Return all evaluation scripts."""
    origin = "scripts.yaml"
    return parse_yaml(_Scripts, files(__package__).joinpath(origin).read_text(encoding="utf-8"), origin).scripts


def find_script(environment: dict[str, Any], *, has_md5: bool = True) -> Script | None:
    """Return the script that prints these environment settings, or None.

    Args:
        environment: as the log prints it.
        has_md5: whether it prints the MD5 of its script; Track 3's peg task of 2025 differs from that of 2024 in this.
    """
    marked = [script for script in all_scripts() if script.marked_by in environment]
    return next((script for script in marked if bool(script.md5) == has_md5), next(iter(marked), None))
