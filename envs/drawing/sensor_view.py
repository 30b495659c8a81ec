"""What a tactile sensor sees, and a team's own design of one."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ..tactile.camera import camera_frame, project
from ..tactile.design import Fault, SensorDesign
from ..tactile.gel import eye_distance_m
from ..tactile.markers import SensingSurface
from .playback import EpisodePlayback, Moment
from .plots import INK, QUIET, TICK_PT, style
from .projection import ParallelCamera
from .visibility import Visible, lit

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

    def __init__(self, playback: EpisodePlayback) -> None:
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


def magnification(playback: EpisodePlayback) -> int:
    """Return how many times longer than they are the arrows of a playback are drawn."""
    flows = np.stack([moment.marker_flow for moment in playback.moments]).astype(np.float64)
    longest = float(np.abs(flows[:, :, 1] - flows[:, :, 0]).max())
    return next((factor for factor in _MAGNIFICATIONS if factor * longest <= _LONGEST_ARROW_PX), 1)


_WIDTH_IN, _HEIGHT_IN = 12.0, 4.0
_SENSING, _DRIVEN, _OTHER = (0.36, 0.62, 0.72), (0.85, 0.62, 0.35), (0.80, 0.82, 0.84)
_VIEW_PX = (600, 500)
_VIEW_HEIGHT_M = 0.028
# A marker lies on a face; a pixel's depth may differ from the marker's by this much.
_DEPTH_SLACK_M = 2e-4
_FAULT_COLOUR = "#b2182b"
# Name of a view, height of the eye above the base's plane [deg].
_VIEWS = (("sensing face", 40.0), ("back face", -40.0))


def draw_design(design: SensorDesign, *, title: str, width_px: int) -> NDArray[np.uint8]:
    """Return the picture, RGB, shape [height, width, 3].

    Args:
        design: the sensor; markers that are not attached are drawn as red crosses.
        title: name of the sensor.
        width_px: width of the picture.
    """
    figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN), dpi=width_px / _WIDTH_IN, facecolor="white")
    nodes = len(design.gel.rest_position_m)
    figure.suptitle(f"{title}: {nodes} nodes, {len(design.markers_mm)} markers", color=INK, size=11.0)
    gels = figure.subplots(1, 3)
    for axes, (name, elevation_deg) in zip(gels, _VIEWS, strict=False):
        _draw_gel(axes, design, elevation_deg)
        style(axes, name)
    _draw_picture(gels[2], design)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


def _draw_gel(axes: Axes, design: SensorDesign, elevation_deg: float) -> None:
    """Draw the faces that look at the eye, the farthest first, and the printed markers that nothing hides."""
    camera = ParallelCamera(
        azimuth_deg=-60.0,
        elevation_deg=elevation_deg,
        centre_m=(0.0, 0.0, 0.0),
        height_m=_VIEW_HEIGHT_M,
        width_px=_VIEW_PX[0],
        height_px=_VIEW_PX[1],
    )
    corners_m = design.gel.rest_position_m[design.gel.surface_triangles]
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normals = normals / np.sqrt((normals * normals).sum(axis=1, keepdims=True)) @ camera.axes.T
    seen = camera.project(corners_m)
    visible = np.flatnonzero(normals[:, 2] < 0.0)
    order = visible[np.argsort(-seen[visible, :, 2].mean(axis=1), kind="stable")]
    colours = lit(_face_colours(design)[order], normals[order])
    axes.add_collection(PolyCollection(list(seen[order, :, :2]), facecolors=colours, edgecolors=INK, linewidths=0.25))
    buffer = Visible.nothing(camera)
    buffer.add(seen[visible], first=0)
    markers = camera.project(design.printed_m)
    free = markers[~buffer.hides(markers, slack_m=_DEPTH_SLACK_M)]
    axes.plot(*free[:, :2].T, linestyle="", marker="o", markersize=2.0, color=INK)
    axes.set(xlim=(0, _VIEW_PX[0]), ylim=(_VIEW_PX[1], 0), aspect="equal", xticks=(), yticks=())


def _face_colours(design: SensorDesign) -> FloatArray:
    gel = design.gel
    sensing = {tuple(sorted(row)) for row in design.sensing_triangles.tolist()}
    colours = np.tile(np.array(_OTHER), (len(gel.surface_triangles), 1))
    colours[gel.driven[gel.surface_triangles].all(axis=1)] = _DRIVEN
    colours[[tuple(sorted(row)) in sensing for row in gel.surface_triangles.tolist()]] = _SENSING
    return colours


def _draw_picture(axes: Axes, design: SensorDesign) -> None:
    """Draw the picture of the undeformed gel."""
    pixels, faults = design.rest_pixels, design.attachment.faults
    attached = faults == Fault.NONE
    axes.plot(*pixels[attached].T, linestyle="", marker="o", markersize=3.5, color=INK)
    axes.plot(*pixels[~attached].T, linestyle="", marker="x", markersize=5.0, color=_FAULT_COLOUR)
    axes.set(xlim=(0, IMAGE_WIDTH_PX), ylim=(IMAGE_HEIGHT_PX, 0), aspect="equal")
    axes.set_xlabel("u [px]", size=TICK_PT, color=QUIET)
    axes.set_ylabel("v [px]", size=TICK_PT, color=QUIET)
    style(axes, "camera")
