"""Drawings of a sensor: its gel, the quality of its mesh, its markers, and its sensitivity. Called by its page."""

from collections.abc import Sequence
from math import cos, radians, sin

from markupsafe import Markup
from vitac.evaluator.figures.figures import SensitivityMap
from vitac.evaluator.sensors.appearance import Appearance, Point

from .axis import Axis, Figure, Table, below, beside, element, joined

KINDS = ("other", "driven", "sensing")
"""Classes of the faces, by their kind."""
_PICTURE = (320, 240)
_STILL = (640, 400)
# From where the still looks at the sensing face: about the vertical, and above the base's plane.
_AZIMUTH_DEG, _ELEVATION_DEG = -60.0, 40.0
_PX_PER_MM = 10.0
HEIGHT_SCALE = 3.0
"""How many times as large heights are drawn: a gel is flat, and its relief is what a team designs."""


def still(looks: Appearance) -> Markup:
    """Return the gel with its markers as a drawing of 640 x 400: faces that look at the eye, the farthest first."""
    seen = [_seen(point, max(z for _, _, z in looks.vertices_mm)) for point in looks.vertices_mm]
    faces = []
    for corners, kind in zip(looks.triangles, looks.kinds, strict=True):
        (ax, ay, a), (bx, by, b), (cx, cy, c) = (seen[corner] for corner in corners)
        # The picture's v points down, so what turns counter-clockwise seen from outside has a negative area here.
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area < 0.0:
            points = f"{ax:.1f},{ay:.1f} {bx:.1f},{by:.1f} {cx:.1f},{cy:.1f}"
            faces.append((a + b + c, points, KINDS[kind]))
    gel = joined(element("polygon", points=points, class_=f"face {kind}") for _, points, kind in sorted(faces))
    thickness_mm = max(z for _, _, z in looks.vertices_mm)
    markers = [_seen(point, thickness_mm) for point in looks.markers_mm]
    return gel + joined(element("circle", class_="marker", cx=x, cy=y, r=2.5) for x, y, _ in markers)


def _seen(point: Point, thickness_mm: float) -> tuple[float, float, float]:
    """Return where a point is drawn [px], and how near to the eye it is."""
    x, y, z = point
    azimuth, elevation = radians(_AZIMUTH_DEG), radians(_ELEVATION_DEG)
    across = -sin(azimuth) * x + cos(azimuth) * y
    away = cos(azimuth) * x + sin(azimuth) * y
    height = HEIGHT_SCALE * (z - 0.5 * thickness_mm)
    up = cos(elevation) * height - sin(elevation) * away
    near = cos(elevation) * away + sin(elevation) * height
    return 0.5 * _STILL[0] + _PX_PER_MM * across, 0.5 * _STILL[1] - _PX_PER_MM * up, near


def quality_histogram(key: str, qualities: Sequence[int]) -> Figure:
    """Return how many tetrahedra have which quality."""
    x = Axis(low=0.0, high=1.0, begin=44.0, end=310.0)
    y = Axis(low=0.0, high=float(max(qualities)), begin=180.0, end=12.0)
    width = (x.end - x.begin) / len(qualities)
    bars = joined(
        element(
            "rect",
            element("title", f"{_bin(number, len(qualities))}: {count} tetrahedra"),
            class_="bar other",
            x=x.place(number / len(qualities)) + 1.0,
            y=y.place(count),
            width=width - 2.0,
            height=y.begin - y.place(count),
        )
        for number, count in enumerate(qualities)
    )
    rows = tuple((_bin(number, len(qualities)), str(count)) for number, count in enumerate(qualities))
    return Figure(
        key=f"quality-{key}",
        title="Quality of the tetrahedra",
        summary="1 is a regular tetrahedron, 0 a flat one; the table has each number.",
        width=320,
        height=206,
        drawing=beside(y, x.begin, x.end) + bars + below(x, y.begin),
        table=Table(columns=("Quality", "Tetrahedra"), rows=rows),
    )


def _bin(number: int, bins: int) -> str:
    return f"{number / bins:.1f} to {(number + 1) / bins:.1f}"


def marker_picture(key: str, markers_px: Sequence[tuple[float, float]]) -> Figure:
    """Return the markers as the camera sees them on the undeformed gel."""
    frame = element("rect", class_="picture-frame", x=0.5, y=0.5, width=_PICTURE[0] - 1, height=_PICTURE[1] - 1)
    dots = joined(element("circle", class_="marker", cx=u, cy=v, r=2.5) for u, v in markers_px)
    rows = tuple((str(number), f"{u:.1f}", f"{v:.1f}") for number, (u, v) in enumerate(markers_px, start=1))
    return Figure(
        key=f"markers-{key}",
        title="Markers in the camera's picture",
        summary=f"{len(markers_px)} markers in a picture of {_PICTURE[0]} x {_PICTURE[1]} pixels.",
        width=_PICTURE[0],
        height=_PICTURE[1],
        drawing=frame + dots,
        table=Table(columns=("Marker", "u [px]", "v [px]"), rows=rows),
    )


def sensitivity_maps(key: str, drawn: SensitivityMap, largest: tuple[float, float]) -> tuple[Figure, Figure]:
    """Return the maps of the sensitivity to normal and to shear forces.

    Args:
        key: ends the plots' ids.
        drawn: of the sensor.
        largest: ends of the scales for normal and shear forces [px/N], which sensors beside each other share.
    """
    normal, shear = drawn.normal_px_n, drawn.shear_px_n
    return (
        _map(f"normal-{key}", "Sensitivity to normal force", drawn, normal, largest[0]),
        _map(f"shear-{key}", "Sensitivity to shear force", drawn, shear, largest[1]),
    )


def find_largest(*rows: Sequence[Sequence[float | None]]) -> float:
    """Return the largest number in maps; 0 where there is none."""
    return max((value for of in rows for row in of for value in row if value is not None), default=0.0)


def _map(key: str, title: str, drawn: SensitivityMap, rows: Sequence[Sequence[float | None]], largest: float) -> Figure:
    step = 22.0
    left, top = 40.0, 12.0
    x = Axis(low=drawn.x_mm[0], high=drawn.x_mm[-1], begin=left + step / 2, end=left + step * (len(drawn.x_mm) - 0.5))
    y = Axis(low=drawn.y_mm[0], high=drawn.y_mm[-1], begin=top + step * (len(drawn.y_mm) - 0.5), end=top + step / 2)
    cells = joined(
        element(
            "rect",
            element("title", f"x {at_x:g} mm, y {at_y:g} mm: {value:.3g} px/N"),
            class_="cell",
            x=x.place(at_x) - step / 2,
            y=y.place(at_y) - step / 2,
            width=step,
            height=step,
            fill_opacity=value / largest if largest else 0.0,
        )
        for at_y, row in zip(drawn.y_mm, rows, strict=True)
        for at_x, value in zip(drawn.x_mm, row, strict=True)
        if value is not None
    )
    end = top + step * len(drawn.y_mm)
    table_rows = tuple(
        (f"{at_y:g}", *("–" if value is None else f"{value:.3g}" for value in row))
        for at_y, row in zip(drawn.y_mm, rows, strict=True)
    )
    return Figure(
        key=key,
        title=f"{title}, 0 to {largest:.3g} px/N",
        summary=f"Motion of all markers together for 1 N at places of the gel, from 0 (light) to {largest:.3g} px/N.",
        width=int(left + step * len(drawn.x_mm) + 8),
        height=int(end + 26),
        drawing=cells + below(x, end, "{:g}".format) + _heights(y, left),
        table=Table(columns=("y [mm] \\ x [mm]", *(f"{value:g}" for value in drawn.x_mm)), rows=table_rows),
    )


def _heights(y: Axis, left: float) -> Markup:
    return joined(
        element("text", f"{tick:g}", class_="tick", x=left - 6.0, y=y.place(tick) + 4.0, text_anchor="end")
        for tick in y.ticks()
    )
