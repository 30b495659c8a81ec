"""What is measured in several tasks."""

from .definition import Better, Measure

SURFACE_DIFF = Measure(
    name="surface_diff_mm",
    label="surface",
    meaning="mean motion of a sensing surface since the grasp",
    unit="mm",
    needs=("surface_diff_m",),
    read=lambda info: tuple(1000 * value for value in info["surface_diff_m"]),
    better=Better.LOW,
)
"""Mean motion of the left and the right sensing surface since the grasp [mm]."""
