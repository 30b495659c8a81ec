"""The figures of a sensor as rows beside those of the reference gel; printed by the command line, shown by pages."""

from collections.abc import Iterator
from typing import NamedTuple

from .figures import SensorFigures


class FigureRow(NamedTuple):
    """One figure; `reference` is that of the reference gel, None where it has none."""

    name: str
    value: float | None
    reference: float | None
    unit: str


def make_rows(figures: SensorFigures, reference: SensorFigures) -> Iterator[FigureRow]:
    """Yield every figure of a sensor."""
    values, others = _values(figures), _values(reference)
    for name, (value, unit) in values.items():
        yield FigureRow(name, value, others.get(name, (None, unit))[0], unit)


def list_missing_rows(figures: SensorFigures) -> Iterator[str]:
    """Yield a sentence for every figure that is not there: what it is, and why."""
    touch, unmeasured = figures.touch, "no start was measured"
    if None in (touch.normal_px_n, touch.shear_px_n, touch.pin_mm, *touch.edge_mm):
        yield "Sensitivity or resolution has no median: no place of the map senses."
    if figures.information is None:
        reason = "at no start did all IPC steps converge" if figures.starts else unmeasured
        yield f"Information and bounds are not there: {reason}."
    if not figures.robustness:
        yield f"The standard score under variations is not there: {unmeasured}."
    if figures.cpu_s is None:
        yield f"The CPU time of an episode is not there: {unmeasured}."


def _values(figures: SensorFigures) -> dict[str, tuple[float | None, str]]:
    touch, grasp, information = figures.touch, figures.grasp, figures.information
    found: dict[str, tuple[float | None, str]] = {
        "sensitivity, normal": (touch.normal_px_n, "px/N"),
        "sensitivity, shear": (touch.shear_px_n, "px/N"),
        "resolution of a pin": (touch.pin_mm, "mm at 1 N"),
        "resolution of an edge across x": (touch.edge_mm[0], "mm at 1 N"),
        "resolution of an edge across y": (touch.edge_mm[1], "mm at 1 N"),
        "indentation at the grasp": (grasp.indentation_mm, "mm"),
        "force at the grasp": (grasp.force_n, "N"),
        "smallest det F": (grasp.smallest_det_f, ""),
    }
    if information is not None:
        for number, bits in enumerate(information.bits, start=1):
            found[f"information before env step {number}"] = (bits, "bit")
        for axis, bound, unit in zip(("x", "y", "theta"), information.bounds, ("mm", "mm", "deg"), strict=True):
            found[f"bound of {axis} before env step {len(information.bits)}"] = (bound, unit)
    for row in figures.robustness:
        found[f"standard score, {row.variation.label}"] = (100 * row.success_rate, "%")
    if figures.cpu_s is not None:
        found["CPU time of an episode"] = (figures.cpu_s, "s")
    return found
