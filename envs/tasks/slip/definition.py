"""The slip task as others need to know it: actions, observables, measures, how it is drawn; light to import."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...observable import Observable
from ...scene.observables import (
    CONTACT_FORCES,
    GRIPPER_WIDTH,
    MEASURED_POSE,
    SURFACE_POINTS,
    marker_flow,
    played_shape,
)
from ...scene.perspective import Beside, InfoView, Perspective, Plane, ProgressPlot, SectionView, signed
from ...tactile.gel import ARENA_SENSING_NODES
from ..definition import OPTIONAL_SENSORS, SURFACE_DIFF, ActionComponent, Better, Measure, TaskDefinition
from ..quantities import TOUCH_QUANTITIES, Quantity, symmetric

FloatArray = NDArray[np.float64]

PART_QUANTITIES = MASS, CENTRE_OF_MASS, LOAD = (
    Quantity(name="part_mass_kg", unit="kg", meaning="Mass of the part", range=(0.05, 1.0), nominal=0.25),
    symmetric(name="centre_of_mass_mm", unit="mm", meaning="Centre of mass beside the middle of the part", largest=2.5),
    Quantity(name="load_n", unit="N", meaning="Load on the part in the end", range=(0.0, 40.0), nominal=12.0),
)


class HasLoad(Protocol):
    """A scene that holds a part under a load."""

    def relative_motion_mm(self) -> FloatArray:
        """Return the commanded height of the gripper above that of the start [mm], shape (1,)."""

    def properties(self) -> FloatArray:
        """Return mass [kg], centre of mass [mm], friction coefficient and load at the end [N], shape (4,)."""

    def load_n(self) -> FloatArray:
        """Return the load now [N], shape (1,)."""


_OWN: tuple[Observable[HasLoad], ...] = (
    Observable(
        name="relative_motion",
        shape=(1,),
        unit="mm",
        meaning="Commanded height of the gripper above that of the start.",
        read=lambda scene, _: scene.relative_motion_mm(),
    ),
    Observable(
        name="part_properties",
        shape=(4,),
        unit="kg, mm, 1, N",
        meaning=(
            "Mass of the part, its centre of mass along x from its middle, friction coefficient of the gels on it, and "
            "the load in the end."
        ),
        read=lambda scene, _: scene.properties(),
        privileged=True,
    ),
    Observable(
        name="load",
        shape=(1,),
        unit="N",
        meaning="Load on the part beside its weight, downwards.",
        read=lambda scene, _: scene.load_n(),
        privileged=True,
    ),
)

GRIP_FORCE = Measure(
    name="grip_force_n",
    label="grip",
    meaning="mean grip force while the load grows",
    unit="N",
    needs=("mean_grip_force_n",),
    read=lambda info: (info["mean_grip_force_n"],),
    better=Better.LOW,
)
"""Mean force of a jaw on the part at the ends of the env steps in which the load grows [N]. In one that an episode did
not reach it counts as the largest that does not crush the part, so that failing early gains nothing."""

TASK = TaskDefinition(
    env_id="ViTac/Slip-v1",
    environment="vitac.envs.tasks.slip.env:SlipEnv",
    actions=(
        ActionComponent(name="z", scale=1.0, unit="mm", meaning="Gripper motion upwards; negative values lower it."),
        ActionComponent(
            name="width", scale=0.2, unit="mm", meaning="Change of the gripper's width; negative values close it."
        ),
    ),
    observables=(
        *_OWN,
        GRIPPER_WIDTH,
        marker_flow("u+ is up for both sensors; v+ is -x for the left and +x for the right one."),
        played_shape("block, bar, column"),
        MEASURED_POSE,
        CONTACT_FORCES,
        SURFACE_POINTS.with_nodes(ARENA_SENSING_NODES),
    ),
    optional_observables=OPTIONAL_SENSORS,
    measures=(GRIP_FORCE, SURFACE_DIFF),
    start_labels=("x {} mm", "z {} mm"),
    perspective="vitac.envs.tasks.slip.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.slip.env:lift_ever_harder",
    guides_exactly=True,
    # The grip is the policy's own.
    quantities=(*(each for each in TOUCH_QUANTITIES if each.name != "indentation_mm"), *PART_QUANTITIES),
    info_lengths={"heights_mm": 6},
)

STANDING_MM = 0.2
"""Height of all lower corners above the table up to which the part stands upright."""


def _position(info: InfoView) -> str:
    return (
        f"grip {info['grip_force_n']:z.1f} N, load {info['load_n']:.1f} N, height {signed(info['heights_mm'].min())} mm"
    )


PERSPECTIVE = Perspective(
    held_name="part",
    fixed_name="table",
    azimuth_deg=-38.0,
    elevation_deg=24.0,
    gel_labels=(Beside.ABOVE, Beside.LEFT),
    cut=Plane(normal=(1.0, 0.0, 0.0), offset_m=1.0),
    section=SectionView(
        title="part and table from the side",
        held_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        fixed_cut=Plane(normal=(0.0, -1.0, 0.0), offset_m=0.0),
        axes=((0, "x"), (2, "z")),
        limits_mm=((-45.0, 45.0), (-8.0, 59.5)),
    ),
    progress=ProgressPlot(
        title="part above table [mm]",
        heights_mm=lambda info: np.asarray(info["heights_mm"]),
        goal_mm=STANDING_MM,
        goal_is_below=True,
    ),
    position=_position,
    arrival="was set down",
)
