"""How much of a step is made: all that contact and inversion allow, or less where the forces would turn round."""

from ...compilation import kernel, large_kernel
from ..contact.broad_phase import Candidates
from ..contact.ccd import PointMove, contact_free_fraction, inversion_free_fraction
from ..model.model import Model
from .forces import force_along, force_along_at
from .iterate import Solve
from .workspace import Workspace

# How far the forces along a cautious step may have turned round at its end, and how often it may be shortened.
_OVERSHOOT = 0.5
_SHORTENINGS = 8


@large_kernel
def feasible_fraction(model: Model, candidates: Candidates, s: Solve) -> float:
    """Return the largest part of the step on which no pair closes too much of its gap and no tetrahedron inverts."""
    fraction = inversion_free_fraction(model.elastic, s.iterate.x, s.step.x, 1.0)
    points = PointMove(s.iterate.y, s.step.y, s.iterate.motion, s.step.motion_ahead)
    return contact_free_fraction(candidates, points, model.parameters.ccd_gap_fraction, fraction)


@large_kernel
def falling_fraction(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, fraction: float) -> float:
    """Return the part of a step away from a balance at whose end the forces still act along it; by halving."""
    bound_motion(s)
    for _ in range(_SHORTENINGS):
        if force_along_at(model, candidates, s, workspace, fraction) < 0.0:
            break
        fraction *= 0.5
    return fraction


@large_kernel
def fraction_without_overshoot(
    model: Model, candidates: Candidates, s: Solve, workspace: Workspace, fraction: float
) -> float:
    """Return the part of a step at whose end the forces along it are turned round by half at most; by regula falsi."""
    here = force_along(model, s.step.solution, workspace.system.gradient)
    bound_motion(s)
    for _ in range(_SHORTENINGS):
        there = force_along_at(model, candidates, s, workspace, fraction)
        if there <= -_OVERSHOOT * here:
            break
        fraction *= max(0.1, min(0.5, here / (here - there)))
    return fraction


@kernel
def bound_motion(s: Solve) -> None:
    """Write a bound of how far pairs of bodies have moved anywhere along the step."""
    for k in range(len(s.trial.motion)):
        s.trial.motion[k] = max(s.iterate.motion[k], s.step.motion_ahead[k])
