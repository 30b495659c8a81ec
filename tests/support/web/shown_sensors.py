"""Sensors on their pages; imported by page tests."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import UUID

from own_sensors import GELS, write_sensor
from vitac.evaluator.figures.table import reference_figures
from vitac.evaluator.scoring.comparison import SensingGain
from vitac.evaluator.sensors.appearance import appearance
from vitac.evaluator.sensors.check import accepted_sensor
from vitac.evaluator.sensors.made import MadeSensor, made_sensor
from vitac.server.views.submissions import DocumentView, SensorView
from vitac.web.pages.submissions.sensors import ShownSensor

MARKERS = "markers: {grid: {columns: 8, rows: 6, spacing_mm: [2.4, 2.0]}}\n"


@cache
def a_made_sensor(gel: str = "ridge") -> MadeSensor:
    with TemporaryDirectory() as name:
        return made_sensor(accepted_sensor(write_sensor(Path(name), GELS[gel](), MARKERS)))


def a_shown_sensor(submission_id: UUID, *, name: str = "done", gel: str = "ridge", **changes: Any) -> ShownSensor:
    made = a_made_sensor(gel)
    values: dict[str, Any] = {
        "digest": made.digest,
        "mesh_digest": made.mesh_digest,
        **made.facts.model_dump(),
        "document": DocumentView(name="design-document.pdf", n_bytes=9, sha256="d0" * 32),
        "coefficients_sha256": None,
        "gain": SensingGain(
            episodes=270,
            starts=90,
            standard_successes=19,
            blind_successes=1,
            gain=0.067,
            low=0.03,
            high=0.1,
            p_value=4e-6,
        ),
        "figures": reference_figures(),
    }
    view = SensorView(**(values | changes))
    return ShownSensor(submission_id=submission_id, name=name, team="Gelbots", view=view, looks=appearance(made))
