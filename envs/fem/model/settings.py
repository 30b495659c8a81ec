"""Settings of a scene: by which contact model bodies touch, and when an IPC step counts as solved."""

from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar, NamedTuple

from vitac.errors import VitacError

from .mesh import GEL_MATERIAL, PART_MATERIAL, GelBody, RigidBody


class UnknownMaterials(VitacError):
    """Two bodies can touch whose materials have no friction coefficient; add one to the contact settings."""


def repr_without_defaults(settings: Any, *names: str) -> str:
    """Return all fields of a dataclass, some of them only where they differ from their default."""
    shown = [
        f"{each.name}={getattr(settings, each.name)!r}"
        for each in fields(settings)
        if each.name not in names or getattr(settings, each.name) != each.default
    ]
    return f"{type(settings).__qualname__}({', '.join(shown)})"


class ContactModel(StrEnum):
    """Contact models by name."""

    CHALLENGE_2025 = "challenge-2025"
    """The 2025 challenge's: friction by the slip of one IPC step, stiffness that depends on the time step."""
    ARENA_2 = "arena-2"
    """Ours: each place of a surface counts once, friction remembers where it sticks, no constant depends on the time
    step."""


class ContactConstants(NamedTuple):
    """What the energy terms need of a contact model, at a given time step."""

    d_hat_m: float
    barrier_stiffness_n_m: float
    affine_stiffness_pa: float
    slip_scale_m: float  # slip of an IPC step at which friction is fully developed, where contacts remember nothing
    tangential_stiffness_n_m: float  # of a contact that sticks, where contacts remember their elastic slip
    is_arena: bool  # whether places of surfaces count once, and contacts remember


@dataclass(frozen=True, kw_only=True)
class ContactSettings:
    """Contact as the 2025 challenge models it; defaults are the peg task's.

    Attributes:
        d_hat_m: distance at which the barrier sets in [m].
        kappa: barrier stiffness, times h^2 [N s^2 / m].
        kappa_affine: stiffness of the orthogonality energy [Pa s^2].
        friction_velocity_m_s: sliding speed at which friction is fully developed, eps_v [m/s].
        ccd_gap_fraction: part of a gap that one Newton iteration may close.
    """

    model: ClassVar = ContactModel.CHALLENGE_2025

    d_hat_m: float = 1e-4
    kappa: float = 100.0
    kappa_affine: float = 1e5
    friction_velocity_m_s: float = 0.01
    ccd_gap_fraction: float = 0.7

    def constants(self, time_step_s: float) -> ContactConstants:
        """Return the constants of the energy terms for a time step [s]."""
        h2 = time_step_s * time_step_s
        return ContactConstants(
            d_hat_m=self.d_hat_m,
            barrier_stiffness_n_m=self.kappa / h2,
            affine_stiffness_pa=self.kappa_affine / h2,
            slip_scale_m=self.friction_velocity_m_s * time_step_s,
            tangential_stiffness_n_m=0.0,
            is_arena=False,
        )

    def pair_friction(self, first: GelBody | RigidBody, second: GelBody | RigidBody) -> float:
        """Return the friction coefficient of two bodies: the mean of both."""
        return 0.5 * (first.friction + second.friction)


@dataclass(frozen=True, kw_only=True)
class PairFriction:
    """Friction coefficient of two materials, in either order."""

    first: str
    second: str
    coefficient: float


class FrictionWeakening(NamedTuple):
    """Friction of two bodies that slide at a speed v: mu (r + (1 - r) / (1 + v / v_s)), mu being their coefficient.

    Attributes:
        kinetic_ratio: r, what is left of the coefficient at a high speed.
        speed_m_s: v_s, at which it is halfway [m/s].
    """

    kinetic_ratio: float
    speed_m_s: float


@dataclass(frozen=True, kw_only=True)
class ArenaContactSettings:
    """Contact as `arena-2` models it: no constant depends on the time step.

    Attributes:
        d_hat_m: distance at which the barrier sets in [m].
        barrier_stiffness_n_m: factor of the barrier [N/m].
        affine_stiffness_pa: factor of the orthogonality energy of rigid parts [Pa].
        tangential_stiffness_n_m: of a contact that sticks, whatever its normal force [N/m].
        ccd_gap_fraction: part of a gap that one Newton iteration may close.
        pair_frictions: friction coefficients by pair of materials.
        weakening: of all of them with the speed of sliding.
    """

    model: ClassVar = ContactModel.ARENA_2

    d_hat_m: float = 1e-4
    barrier_stiffness_n_m: float = 1e4
    affine_stiffness_pa: float = 1e9
    tangential_stiffness_n_m: float = 1e5
    ccd_gap_fraction: float = 0.7
    pair_frictions: tuple[PairFriction, ...] = (
        PairFriction(first=GEL_MATERIAL, second=PART_MATERIAL, coefficient=1.0),
        PairFriction(first=PART_MATERIAL, second=PART_MATERIAL, coefficient=0.3),
        PairFriction(first=GEL_MATERIAL, second=GEL_MATERIAL, coefficient=1.0),
    )
    weakening: FrictionWeakening | None = None

    def __repr__(self) -> str:
        """Return all fields, the last one only where it is set: mesh hashes of settings without it stay."""
        return repr_without_defaults(self, "weakening")

    def constants(self, time_step_s: float) -> ContactConstants:  # noqa: ARG002 - the same for every time step
        """Return the constants of the energy terms, whatever the time step [s]."""
        return ContactConstants(
            d_hat_m=self.d_hat_m,
            barrier_stiffness_n_m=self.barrier_stiffness_n_m,
            affine_stiffness_pa=self.affine_stiffness_pa,
            slip_scale_m=0.0,
            tangential_stiffness_n_m=self.tangential_stiffness_n_m,
            is_arena=True,
        )

    def pair_friction(self, first: GelBody | RigidBody, second: GelBody | RigidBody) -> float:
        """Return the friction coefficient of the materials of two bodies.

        Raises:
            UnknownMaterials: there is none for them.
        """
        for pair in self.pair_frictions:
            if sorted((pair.first, pair.second)) == sorted((first.material, second.material)):
                return pair.coefficient
        raise UnknownMaterials(
            f"There is no friction coefficient of {first.material} against {second.material}; "
            "add one to pair_frictions of the contact settings."
        )


AnyContactSettings = ContactSettings | ArenaContactSettings


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


@dataclass(frozen=True, kw_only=True)
class CutOffSolverSettings(SolverSettings):
    """The `cut_off` profile: every IPC step ends after a few Newton iterations, whatever forces are left then.

    The 2025 simulator ends its steps so. Only comparisons with its logs use this; a ranked task has
    the `converged` profile, whose settings and hash do not know of it.

    Attributes:
        iterations_per_step: number of Newton iterations of an IPC step; fewer where it is solved before.
    """

    iterations_per_step: int = 5
