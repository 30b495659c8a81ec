"""Contact forces on the held part as few arrows: one of each gel, and some where it touches the fixed part."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..fem.contact.forces import PairForces
from ..scene.gripper import SENSOR_COUNT

FloatArray = NDArray[np.float64]

PLACES: Final = 6
"""Most places at which the held part is shown to touch the fixed one."""
_HELD, _FIXED = SENSOR_COUNT, SENSOR_COUNT + 1
_REACH_M = 2e-3
"""Contacts within this distance of the strongest one become one arrow."""


def make_arrows(found: PairForces) -> tuple[FloatArray, FloatArray]:
    """Return where forces act on the held part [m] and how large they are [N], shapes [2 + PLACES, 3].

    First those of the left and the right gel, then those of the fixed part, the strongest contact's first; rows without
    a force are zero. A place is the mean of the contacts that its arrow adds up, weighted by their forces.
    """
    places, forces = np.zeros((SENSOR_COUNT + PLACES, 3)), np.zeros((SENSOR_COUNT + PLACES, 3))
    for gel in range(SENSOR_COUNT):
        points_m, forces_n = _select_on_held(found, gel)
        if len(points_m):
            places[gel], forces[gel] = _add_up(points_m, forces_n)
    points_m, forces_n = _select_on_held(found, _FIXED)
    for row in range(SENSOR_COUNT, SENSOR_COUNT + PLACES):
        if not len(points_m):
            break
        strongest = points_m[np.square(forces_n).sum(axis=1).argmax()]
        near = np.square(points_m - strongest).sum(axis=1) <= _REACH_M**2
        places[row], forces[row] = _add_up(points_m[near], forces_n[near])
        points_m, forces_n = points_m[~near], forces_n[~near]
    return places, forces


def _select_on_held(found: PairForces, other: int) -> tuple[FloatArray, FloatArray]:
    """Return the places [m] and forces [N] of contacts on the held part with another body."""
    first, second = found.bodies.T
    acts = (first == _HELD) & (second == other)
    reacts = (first == other) & (second == _HELD)
    return (
        np.concatenate([found.points_m[acts], found.points_m[reacts]]),
        np.concatenate([found.forces_n[acts], -found.forces_n[reacts]]),
    )


def _add_up(points_m: FloatArray, forces_n: FloatArray) -> tuple[FloatArray, FloatArray]:
    weights = np.sqrt(np.square(forces_n).sum(axis=1))[:, None]
    return (weights * points_m).sum(axis=0) / weights.sum(), forces_n.sum(axis=0)
