"""The figures that benchmarks/physics.md shows, kept between measurements."""

import json
from pathlib import Path

from .tables import Figures, fill_tables

REPOSITORY = Path(__file__).resolve().parents[2]
FIGURES = REPOSITORY / "benchmarks" / "physics.json"
DOCUMENT = REPOSITORY / "benchmarks" / "physics.md"


def keep(figures: Figures) -> None:
    """Replace the figures of the same names, and write all tables again."""
    kept: Figures = json.loads(FIGURES.read_text()) | figures
    document = fill_tables(DOCUMENT.read_text(), kept)
    FIGURES.write_text(json.dumps(kept, indent=1) + "\n")
    DOCUMENT.write_text(document)
