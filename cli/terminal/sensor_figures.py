"""Prints the figures of a sensor beside those of the reference gel. Called by `vitac sensor evaluate`."""

from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import make_rows, reference_figures

from .output import print_table


def print_figures(figures: SensorFigures) -> None:
    """Print all figures of a sensor, and their digest."""
    rows = [
        (row.name, _text(row.value), _text(row.reference), row.unit) for row in make_rows(figures, reference_figures())
    ]
    print_table(("figure", "sensor", "reference gel", "unit"), rows, none="")
    print(f"{figures.starts} starts; digest of the figures {figures.digest}")


def _text(value: float | None) -> str | None:
    return None if value is None else f"{value:.4g}"
