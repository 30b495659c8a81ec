"""The surfaces that a camera can see: triangles of several bodies, whose vertices move."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ..errors import VitacError

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


class Label(IntEnum):
    """What a pixel shows; the values are those of the `segmentation` picture."""

    NOTHING = 0
    BASE = 1
    PEG = 2
    LEFT_GEL = 3
    RIGHT_GEL = 4
    CLUTTER_OF_BASE = 5  # in the base's colour
    CLUTTER_OF_PEG = 6  # in the peg's


class VerticesDoNotFit(VitacError):
    """Positions were given that do not fit the bodies of a scene; the message names the shapes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Closed surface of one body.

    Attributes:
        vertex_count: number of its vertices; a gel's are all its nodes.
        triangles: vertex indices, counter-clockwise seen from outside, shape [t, 3].
        label: what its pixels are called.
    """

    vertex_count: int
    triangles: IndexArray
    label: Label


class VisibleSurfaces:
    """The triangles of several bodies in one list, made once; only their vertices change between pictures.

    Attributes:
        triangles: indices into the vertices of all bodies, one body after the other, shape [t, 3].
        labels: label of every triangle, shape [t].
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        counts = [body.vertex_count for body in bodies]
        starts = np.concatenate([[0], np.cumsum(counts)])
        self._shapes = [(count, 3) for count in counts]
        self.triangles: IndexArray = np.ascontiguousarray(
            np.concatenate([body.triangles + start for body, start in zip(bodies, starts[:-1], strict=True)])
        )
        self.labels: NDArray[np.uint8] = np.repeat(
            np.array([body.label for body in bodies], dtype=np.uint8), [len(body.triangles) for body in bodies]
        )

    def vertices_m(self, positions_m: Sequence[FloatArray]) -> FloatArray:
        """Join the bodies' vertex positions in the world [m] to one array, shape [n, 3].

        Raises:
            VerticesDoNotFit: a body is missing, or has another number of vertices.
        """
        shapes = [position.shape for position in positions_m]
        if shapes != self._shapes:
            raise VerticesDoNotFit(f"Positions have the shapes {shapes}, expected {self._shapes}.")
        return np.concatenate(positions_m)
