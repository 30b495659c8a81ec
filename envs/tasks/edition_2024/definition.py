"""Both tasks of 2024 as others need to know them: what they have other than those of 2025; light to import."""

from dataclasses import replace

from ...geometry.pegs_2024 import PegShape2024
from ...scene.observables import played_shape
from ...scene.perspective import Perspective, ProgressPlot
from ..definition import ActionComponent
from ..lock_opening.definition import CEILING_Z_M, heights_mm
from ..lock_opening.definition import PERSPECTIVE as LOCK_PERSPECTIVE
from ..lock_opening.definition import TASK as LOCK_2025
from ..peg_insertion.definition import FORM_QUANTITIES
from ..peg_insertion.definition import TASK as PEG_2025

SUCCESS_Z_RANGE_M = (37e-3, 40e-3)
"""Where all top corners of both measured teeth must be."""

_SHAPE = played_shape(", ".join(PegShape2024))
PEG_TASK = replace(
    PEG_2025,
    env_id="ViTac/PegInsertion2024-v1",
    environment="vitac.envs.tasks.edition_2024.env:PegInsertion2024Env",
    observables=tuple(
        _SHAPE if entry.name == _SHAPE.name else entry
        for entry in PEG_2025.observables
        if entry.name != "relative_motion"
    ),
    accepts_start="vitac.envs.tasks.edition_2024.env:accepts_start",
    quantities=tuple(quantity for quantity in PEG_2025.quantities if quantity not in FORM_QUANTITIES),
)

LOCK_TASK = replace(
    LOCK_2025,
    env_id="ViTac/LockOpening2024-v1",
    environment="vitac.envs.tasks.edition_2024.env:LockOpening2024Env",
    actions=tuple(
        ActionComponent(name=name, scale=scale, unit="mm", meaning=f"Gripper motion along -{name}. {more}")
        for name, scale, more in (
            ("x", 4.0, "Positive values push the key in. Nothing is clipped; all three are moved together."),
            ("y", 2.0, "As x."),
            ("z", 2.0, "Negative values lift the key; as x."),
        )
    ),
    perspective="vitac.envs.tasks.edition_2024.definition:PERSPECTIVE",
    guided_motion="vitac.envs.tasks.edition_2024.env:in_and_up",
)

TASKS = (PEG_TASK, LOCK_TASK)

PERSPECTIVE: Perspective = replace(
    LOCK_PERSPECTIVE,
    section=replace(LOCK_PERSPECTIVE.section, limits_mm=((-4.0, 166.0), (-6.0, 48.0))),
    progress=ProgressPlot(
        title="teeth above ceiling [mm]",
        heights_mm=heights_mm,
        goal_mm=1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M),
        goal_is_below=False,
    ),
)
