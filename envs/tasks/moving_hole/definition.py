"""The task of the moving hole as others need to know it: what it has other than the peg task; light to import."""

from dataclasses import replace
from typing import Any, Protocol

from ...observable import Observable
from ...scene.observables import SURFACE_POINTS
from ...scene.perspective import FloatArray
from ...tactile.gel import ARENA_SENSING_NODES
from ..insertion.interface import gt_offset, relative_motion
from ..peg_insertion.definition import TASK as PEG_TASK
from ..quantities import Quantity

PLATE_SPEED = Quantity(
    name="plate_speed_mm_s",
    unit="mm/s",
    meaning="Largest speed of the plate",
    range=(0.0, 3.0),
    nominal=0.0,
)


class HasPlate(Protocol):
    """A scene whose plate moves."""

    def plate_step_mm(self) -> FloatArray:
        """Return how far the plate moves in the next env step [mm], shape (2,)."""


_PLATE_STEP: Observable[HasPlate] = Observable(
    name="plate_step",
    shape=(2,),
    unit="mm",
    meaning="How far the plate moves in the next env step, [x, y]; world frame.",
    read=lambda scene, _: scene.plate_step_mm(),
    privileged=True,
)
_OWN: dict[str, Observable[Any]] = {
    "surface_pts": SURFACE_POINTS.with_nodes(ARENA_SENSING_NODES),
    "gt_offset": gt_offset("mm, mm, degree", "[x, y, theta] where it is now; world frame."),
    "relative_motion": relative_motion(
        "the start; world frame, not that of the plate; the descent before the first step is not counted."
    ),
}

TASK = replace(
    PEG_TASK,
    env_id="ViTac/MovingHole-v1",
    environment="vitac.envs.tasks.moving_hole.env:MovingHoleEnv",
    observables=(*(_OWN.get(entry.name, entry) for entry in PEG_TASK.observables), _PLATE_STEP),
    guided_motion="vitac.envs.tasks.moving_hole.env:to_where_the_hole_will_be",
    quantities=(*PEG_TASK.quantities, PLATE_SPEED),
)
