"""What reports of re-simulations show of several tasks."""

from .definition import Measure

SURFACE_DIFF = Measure(
    name="surface_diff_mm",
    label="surface",
    needs=("surface_diff_m",),
    read=lambda info: tuple(1000 * value for value in info["surface_diff_m"]),
)
"""Mean motion of the left and the right sensing surface since the grasp [mm]."""
