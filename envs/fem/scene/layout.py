"""Which nodes of a scene belong to which body, and whether bodies and settings can be used."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..affine import frame_weights
from ..model.mesh import GelBody, RigidBody
from ..model.settings import AnyContactSettings, CutOffSolverSettings, SolverSettings

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NodeLayout:
    """Where the bodies' nodes stand in the scene's node array."""

    gels: tuple[GelBody, ...]
    bodies: tuple[RigidBody, ...]
    gel_slices: list[slice] = field(init=False, default_factory=list)
    body_slices: list[slice] = field(init=False, default_factory=list)
    body_weights: list[FloatArray] = field(init=False, default_factory=list)
    body_centroids_m: list[FloatArray] = field(init=False, default_factory=list)
    body_lengths_m: list[float] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        count = 0
        for gel in self.gels:
            self.gel_slices.append(slice(count, count + len(gel.mesh.rest_position_m)))
            count += len(gel.mesh.rest_position_m)
        for body in self.bodies:
            volume, first, _ = body.mesh.moments
            centroid = first / volume
            length = float(np.abs(body.mesh.vertices_m - centroid).max())
            self.body_slices.append(slice(count, count + 4))
            self.body_centroids_m.append(centroid)
            self.body_lengths_m.append(length)
            self.body_weights.append(frame_weights(body.mesh.vertices_m, centroid, length))
            count += 4

    def point_weights(self, body: int, point_m: FloatArray) -> FloatArray:
        """Return the weights of a body's frame points that give a point of its frame [m], shape [3] to [4]."""
        weights = frame_weights(np.asarray(point_m)[None], self.body_centroids_m[body], self.body_lengths_m[body])
        return np.asarray(weights[0])

    def initial_positions_m(self) -> FloatArray:
        """Return the node positions [m] of shape [n, 3] as the bodies were placed."""
        parts = [placed(gel.mesh.rest_position_m, gel) for gel in self.gels]
        for body, centroid, length in zip(self.bodies, self.body_centroids_m, self.body_lengths_m, strict=True):
            frame = centroid + length * np.concatenate([np.zeros((1, 3)), np.eye(3)])
            parts.append(placed(frame, body))
        return np.concatenate(parts)


def placed(points_m: FloatArray, body: GelBody | RigidBody) -> FloatArray:
    """Return the points in the world: rotation @ point + translation, without BLAS."""
    return np.asarray((body.rotation[None, :, :] * points_m[:, None, :]).sum(axis=2) + body.translation_m)


# Largest error of a rotation's entries that rounding explains.
_ROTATION_ERROR = 1e-9
# From this Poisson's ratio on tetrahedra are refused: the ball of docs/real-gel.md is 1.74 times too stiff at 0.49.
_LOCKING_POISSON_RATIO = 0.49


class SceneError(VitacError):
    """A scene cannot be built or stepped with what was given; the message names the body and the value."""


def check_bodies(gels: Sequence[GelBody], bodies: Sequence[RigidBody]) -> None:
    """Look at where bodies stand and what they are made of.

    Raises:
        SceneError: there is no gel, a body is placed by no rotation or at no finite place, or a material is none.
    """
    if not gels:
        raise SceneError("A scene needs at least one gel, got none.")
    for index, gel in enumerate(gels):
        name = f"gel {index}"
        _check_place(name, gel)
        _check_positive(name, youngs_modulus_pa=gel.youngs_modulus_pa, density_kg_m3=gel.density_kg_m3)
        if not 0.0 <= gel.poisson_ratio < 0.5:
            raise SceneError(f"poisson_ratio of {name} is {gel.poisson_ratio}, expected at least 0 and less than 0.5.")
        if gel.poisson_ratio >= _LOCKING_POISSON_RATIO and not gel.mesh.is_hexahedral:
            raise SceneError(
                f"poisson_ratio of {name} is {gel.poisson_ratio}, but {gel.mesh.name} is of linear tetrahedra, which "
                f"lock: at {_LOCKING_POISSON_RATIO} a ball presses 1.7 times as hard as into the continuum; mesh it by "
                "hexahedra or give it a smaller one."
            )
        cells, factor = len(gel.mesh.hexahedra), gel.stiffening
        if factor is not None and not (factor.shape == (cells,) and ((factor > 0.0) & np.isfinite(factor)).all()):
            raise SceneError(
                f"stiffening of {name} has shape {factor.shape}, expected a positive finite number for each of the "
                f"{cells} hexahedra of {gel.mesh.name}."
            )
        if gel.motion is not None and gel.mesh.is_free:
            raise SceneError(f"{name} has a motion, but {gel.mesh.name} has no driven nodes that it could move.")
        for branch in gel.viscosity:
            _check_positive(f"the viscosity of {name}", relaxation_time_s=branch.relaxation_time_s)
            if not 0.0 <= branch.modulus_ratio < np.inf:
                raise SceneError(
                    f"modulus_ratio of the viscosity of {name} is {branch.modulus_ratio}, expected at least 0."
                )
        if gel.viscosity and not gel.mesh.is_hexahedral:
            raise SceneError(f"{name} has viscosity, but {gel.mesh.name} is of tetrahedra; mesh it by hexahedra.")
        second, third = gel.yeoh
        if not (gel.mesh.is_hexahedral or second == third == 0.0):
            raise SceneError(f"{name} has Yeoh's law, but {gel.mesh.name} is of tetrahedra; mesh it by hexahedra.")
        # Its stress then grows with every strain: 1 + 2 a e + 3 b e^2 is positive for all e.
        if not (np.isfinite(second) and 0.0 <= third < np.inf and (second >= 0.0 or second * second < 3.0 * third)):
            raise SceneError(
                f"yeoh of {name} is {gel.yeoh}, expected (C20, C30) over C10 with C30 of at least 0 and, where C20 is "
                "negative, C20^2 < 3 C30."
            )
    for index, body in enumerate(bodies):
        _check_place(f"body {index}", body)
        _check_positive(f"body {index}", density_kg_m3=body.density_kg_m3)
        if body.motion is not None and not body.fixed:
            raise SceneError(f"body {index} has a motion, but is not fixed; only what nothing else moves can have one.")
        if body.fixed and (body.load is not None or body.point_masses):
            raise SceneError(
                f"body {index} has a load or point masses, but is fixed; only movable bodies can have them."
            )
        for mass_kg, point_m in body.point_masses:
            _check_positive(f"a point mass of body {index}", mass_kg=mass_kg)
            if np.shape(point_m) != (3,) or not np.isfinite(point_m).all():
                raise SceneError(f"A point mass of body {index} is at {point_m}, expected three finite numbers [m].")


def check_settings(time_step_s: float, contact: AnyContactSettings, solver: SolverSettings) -> None:
    """Look at the ranges of all settings.

    Raises:
        SceneError: one is out of its range.
    """
    _check_positive("the scene", time_step_s=time_step_s)
    numbers = {field.name: getattr(contact, field.name) for field in fields(contact) if field.type is float}
    _check_positive("the contact", **numbers)
    for pair in getattr(contact, "pair_frictions", ()):
        _check_friction(f"{pair.first} against {pair.second}", pair.coefficient)
    if not 0.0 < contact.ccd_gap_fraction < 1.0:
        raise SceneError(f"ccd_gap_fraction is {contact.ccd_gap_fraction}, expected more than 0 and less than 1.")
    _check_positive(
        "the solver",
        step_tolerance_m=solver.step_tolerance_m,
        residual_tolerance_n=solver.residual_tolerance_n,
        newton_iterations=solver.newton_iterations,
        phase_iterations=solver.phase_iterations,
        candidate_margin_m=solver.candidate_margin_m,
    )
    if isinstance(solver, CutOffSolverSettings):
        _check_positive("the solver", iterations_per_step=solver.iterations_per_step)
    if not 0 <= solver.first_division_level <= solver.division_levels:
        level, levels = solver.first_division_level, solver.division_levels
        raise SceneError(f"first_division_level is {level}, expected 0 to division_levels = {levels}.")
    if solver.saddle_escapes < 0:
        raise SceneError(f"saddle_escapes is {solver.saddle_escapes}, expected 0 or more.")


def _check_place(name: str, body: GelBody | RigidBody) -> None:
    if not np.isfinite(body.translation_m).all():
        raise SceneError(f"translation_m of {name} is {body.translation_m}, expected finite numbers.")
    R = np.asarray(body.rotation, dtype=np.float64)
    products = (R[:, None, :] * R[None, :, :]).sum(axis=2)
    handedness = (R[0] * (R[1][[1, 2, 0]] * R[2][[2, 0, 1]] - R[1][[2, 0, 1]] * R[2][[1, 2, 0]])).sum()
    if not (np.abs(products - np.eye(3)).max() <= _ROTATION_ERROR and handedness > 0):
        raise SceneError(f"rotation of {name} is {R.tolist()}, expected a rotation matrix of determinant 1.")
    _check_friction(name, body.friction)


def _check_friction(owner: str, coefficient: float) -> None:
    if not (np.isfinite(coefficient) and coefficient >= 0):
        raise SceneError(f"friction of {owner} is {coefficient}, expected 0 or more.")


def _check_positive(owner: str, **values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise SceneError(f"{name} of {owner} is {value}, expected more than 0.")
