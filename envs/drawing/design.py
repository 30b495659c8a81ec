"""A still picture of a team's own sensor: the gel with its markers from both sides, and what the camera sees."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..tactile.attachment import Fault
from ..tactile.design import SensorDesign
from .plots import INK, QUIET, TICK_PT, style
from .projection.camera import ParallelCamera
from .projection.shading import lit
from .projection.visibility import Visible
from .sensor_view import IMAGE_HEIGHT_PX, IMAGE_WIDTH_PX

FloatArray = NDArray[np.float64]

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
