"""Friction that weakens with the speed of sliding, as that of rubber on plastic may."""

import numpy as np
from numpy.typing import NDArray

from ..model.model import Surfaces
from ..model.settings import FrictionWeakening
from .distance import EDGE_EDGE
from .forces import ContactMemory

FloatArray = NDArray[np.float64]


def weaken_friction(
    law: FrictionWeakening, surfaces: Surfaces, memory: ContactMemory, y: FloatArray, velocity_m_s: FloatArray
) -> FloatArray:
    """Return the coefficients of all pairs of bodies in an IPC step, shape [k].

    Their speed is the mean over their contacts at its start, so that the step itself is solved with fixed ones.

    Args:
        law: by which they weaken.
        surfaces: of the scene, with the coefficients at rest.
        memory: contacts at the start.
        y: points [m] at the start, shape [p, 3].
        velocity_m_s: of the points, shape [p, 3].
    """
    kind, points = memory.pairs[:, 0], memory.pairs[:, 1:5]
    is_edges = (kind == EDGE_EDGE)[:, None]
    x, v = y[points], velocity_m_s[points]
    along = np.where(is_edges, x[:, 1] - x[:, 0], x[:, 2] - x[:, 1])
    normal = np.cross(along, x[:, 3] - np.where(is_edges, x[:, 2], x[:, 1]))
    normal /= np.maximum(np.sqrt((normal**2).sum(axis=1, keepdims=True)), np.finfo(float).tiny)
    between = np.where(is_edges, 0.5 * (v[:, 0] + v[:, 1] - v[:, 2] - v[:, 3]), v[:, 0] - v[:, 1:].mean(axis=1))
    between -= (between * normal).sum(axis=1, keepdims=True) * normal
    speeds = np.sqrt((between**2).sum(axis=1))
    bodies = np.sort(surfaces.point_body[points[:, [0, 3]]], axis=1)
    row = (surfaces.pairs[None] == bodies[:, None]).all(axis=2).argmax(axis=1)
    counts = np.bincount(row, minlength=len(surfaces.pairs))
    mean_m_s = np.bincount(row, weights=speeds, minlength=len(surfaces.pairs)) / np.maximum(counts, 1)
    part = law.kinetic_ratio + (1.0 - law.kinetic_ratio) / (1.0 + mean_m_s / law.speed_m_s)
    return np.asarray(surfaces.pair_friction * part)
