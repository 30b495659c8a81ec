"""What both sensors feel, in the coordinates of their pictures: colours on the gel's face, and the marker flow."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, Normalize
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ..tactile.camera import camera_frame, project
from ..tactile.markers import SensingSurface
from ..tactile.thickness import eye_distance_m
from .playback import Moment, Playback
from .plots import INK, TICK_PT, style

FloatArray = NDArray[np.float64]

IMAGE_WIDTH_PX, IMAGE_HEIGHT_PX = 320, 240
# Arrows are lengthened by one of these, the largest that keeps the longest of an episode below this length.
_MAGNIFICATIONS = (20, 10, 5, 2, 1)
_LONGEST_ARROW_PX = 45.0
_ARROW_COLOUR = "#10243e"


@dataclass(frozen=True, kw_only=True)
class Side:
    """One of the two sensors."""

    index: int
    name: str


SIDES = (Side(index=0, name="left"), Side(index=1, name="right"))


class SensorPanels:
    """Draws the sensors of a playback, arrows of all moments on one scale."""

    def __init__(self, playback: Playback) -> None:
        self._mesh = playback.gel
        self._camera, self._eye_distance_m = playback.camera, eye_distance_m(playback.gel)
        self._triangles = SensingSurface.from_gel(playback.gel).triangles
        self._magnification = magnification(playback)

    def draw(
        self, axes: Axes, side: Side, moment: Moment, values: FloatArray, *, cmap: Colormap, norm: Normalize
    ) -> None:
        """Draw one sensor's picture; values at all nodes of its gel, and their colours."""
        face = self._face_px(moment, side)
        axes.tripcolor(face, values[self._mesh.sensing_nodes], shading="gouraud", cmap=cmap, norm=norm)
        start, flow = arrows(moment.marker_flow[side.index])
        axes.quiver(
            *start.T,
            *(self._magnification * flow.T),
            color=_ARROW_COLOUR,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.0055,
            headwidth=3.6,
            headlength=4.0,
            headaxislength=3.6,
            minshaft=1.5,
            minlength=0.6,
        )
        axes.set(xlim=(0, IMAGE_WIDTH_PX), ylim=(IMAGE_HEIGHT_PX, 0), aspect="equal", xticks=(0, 100, 200, 300))
        axes.set_yticks((0, 100, 200))
        axes.set_xlabel("u [px]", size=TICK_PT, color=INK, labelpad=1)
        style(axes, f"{side.name} sensor, marker flow ×{self._magnification}")
        if side.index == 0:
            axes.set_ylabel("v [px]", size=TICK_PT, color=INK, labelpad=1)
        else:
            axes.set_yticklabels([])

    def _face_px(self, moment: Moment, side: Side) -> Triangulation:
        """Return the sensing surface as its camera sees it."""
        pose = moment.sensor_poses[side.index]
        nodes_m = moment.gel_nodes_m[side.index][self._mesh.sensing_nodes]
        pixels = project(camera_frame(nodes_m, pose.rotation, pose.centre_m, self._eye_distance_m), self._camera)
        return Triangulation(pixels[:, 0], pixels[:, 1], self._triangles)


def arrows(marker_flow: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Start and lengths of the marker flow of one sensor [pixel], shapes [m, 2]; each marker once.

    Args:
        marker_flow: reference and current positions, shape [2, 128, 2]; the last one is repeated where fewer are seen.
    """
    pairs = np.unique(np.concatenate([marker_flow[0], marker_flow[1]], axis=1), axis=0).astype(np.float64)
    return pairs[:, :2], pairs[:, 2:] - pairs[:, :2]


def magnification(playback: Playback) -> int:
    """Return how many times longer than they are the arrows of a playback are drawn."""
    flows = np.stack([moment.marker_flow for moment in playback.moments]).astype(np.float64)
    longest = float(np.abs(flows[:, :, 1] - flows[:, :, 0]).max())
    return next((factor for factor in _MAGNIFICATIONS if factor * longest <= _LONGEST_ARROW_PX), 1)
