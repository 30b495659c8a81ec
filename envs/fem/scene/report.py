"""What one IPC step took and left."""

from dataclasses import dataclass
from enum import StrEnum
from math import sqrt


class StepStatus(StrEnum):
    """How an IPC step ended."""

    CONVERGED = "converged"  # solved in one go
    DIVIDED = "divided"  # solved after the driven motion was divided
    ESCAPED_SADDLE = "escaped_saddle"  # solved after an unstable equilibrium was left along negative curvature
    RELAXED = "relaxed"  # solved after the forces were relaxed along their flow
    SHORTENED = "shortened"  # played as several shorter IPC steps, each solved
    CONTINUED = "continued"  # solved by following balances from the start, while held forces were released
    GAVE_WAY = "gave_way"  # solved with part of the friction, as with all of it there was no solution
    CUT_OFF = "cut_off"  # ended after the iterations of `CutOffSolverSettings`, not solved
    NOT_CONVERGED = "not_converged"  # not solved; the state is free of intersections but is not a minimum


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """What one IPC step took and left.

    Attributes:
        status: how it ended; a caller must not continue after NOT_CONVERGED.
        newton_iterations: Newton iterations, all parts together.
        parts: parts the driven motion was divided into where this state comes from, or shorter IPC steps.
        reusing_iterations: iterations that solved with the factors of an earlier one, among the Newton iterations.
        projected_iterations: iterations whose Hessian had to be projected to be positive definite.
        unstable_solutions: how often an equilibrium was reached whose Jacobian has a negative determinant.
        saddle_escapes: how often one was left in the end, as dividing led to no stable one.
        residual_n: largest force left on a node [N].
        net_force_n: largest net force left on a movable body [N].
        net_torque_n_m: largest net torque left on a movable body, about its centroid [N m].
        smallest_gap_m: smallest distance of two bodies [m]; infinite when nothing is within d_hat.
        smallest_det_f: smallest det F of all elements.
        active_contacts: pairs closer than d_hat.
        gel_forces_n: force of the contacts on each gel [N], as its driven nodes hold it; shape [g, 3].
        largest_stretch: largest principal stretch of the elements of all gels; 1 where nothing is stretched.
        high_stretch: the one that 95 % of these elements do not exceed.
        time_step_s: length of the step [s].
    """

    status: StepStatus
    newton_iterations: int
    parts: int
    reusing_iterations: int
    projected_iterations: int
    unstable_solutions: int
    saddle_escapes: int
    residual_n: float
    net_force_n: float
    net_torque_n_m: float
    smallest_gap_m: float
    smallest_det_f: float
    active_contacts: int
    gel_forces_n: tuple[tuple[float, float, float], ...] = ()
    largest_stretch: float = 1.0
    high_stretch: float = 1.0
    time_step_s: float = 0.1

    @property
    def part_force_n(self) -> float:
        """Force of what does not hold the part, as all gels together hold it [N]."""
        total = map(sum, zip(*self.gel_forces_n, strict=True))
        return sqrt(sum(along * along for along in total))
