"""Settings of a scene: how bodies touch, and when an IPC step counts as solved."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ContactSettings:
    """Contact of all pairs of different bodies; defaults are the peg task's (challenge-facts 3).

    Attributes:
        d_hat_m: distance at which the barrier sets in [m].
        kappa: barrier stiffness, times h^2 [N s^2 / m].
        kappa_affine: stiffness of the orthogonality energy [Pa s^2].
        friction_velocity_m_s: sliding speed at which friction is fully developed, eps_v [m/s].
        ccd_gap_fraction: part of a gap that one Newton iteration may close.
    """

    d_hat_m: float = 1e-4
    kappa: float = 100.0
    kappa_affine: float = 1e5
    friction_velocity_m_s: float = 0.01
    ccd_gap_fraction: float = 0.7


@dataclass(frozen=True, kw_only=True)
class SolverSettings:
    """The `converged` profile: when an IPC step counts as solved.

    Attributes:
        step_tolerance_m: largest move of the last Newton iteration [m].
        residual_tolerance_n: largest force left on a node, friction taken at the solution [N].
        newton_iterations: largest number of Newton iterations of one solve, not counting those that reuse factors.
        phase_iterations: length of a turn of free Newton iterations, and of the first cautious one.
        first_division_level: how often the driven motion is halved from the start.
        division_levels: how often the driven motion may be halved when an IPC step does not converge whole.
        saddle_escapes: how many saddles may be left at the end of a motion, where dividing finds no stable equilibrium.
        candidate_margin_m: relative motion that a list of candidate pairs stays good for [m].
    """

    step_tolerance_m: float = 1e-8
    residual_tolerance_n: float = 1e-4
    newton_iterations: int = 228
    phase_iterations: int = 12
    first_division_level: int = 0
    division_levels: int = 4
    saddle_escapes: int = 3
    candidate_margin_m: float = 2e-4
