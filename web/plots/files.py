"""Plots as files for papers and slides: SVG with its colours, and PDF of the same lines. Called by the pages."""

import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from xml.etree import ElementTree as ET

from markupsafe import Markup, escape
from starlette.requests import Request
from starlette.responses import Response

from .axis import Figure

_INK, _QUIET, _ACCENT, _BAD, _GOOD, _STRONG = "#15191c", "#545e66", "#0a6a66", "#b0401c", "#1b7446", "#858f96"
STYLES: Mapping[str, Mapping[str, str]] = {
    "tick": {"fill": _QUIET, "font-size": "11"},
    "label": {"fill": _INK, "font-size": "13"},
    "grid": {"stroke": "#dde1e2", "stroke-width": "1"},
    "axis": {"stroke": _STRONG, "stroke-width": "1"},
    "band": {"fill": "#b9dedb"},
    "point": {"fill": _ACCENT},
    "point faint": {"opacity": "0.5"},
    "point own": {"stroke": _INK, "stroke-width": "2"},
    "median": {"stroke": _INK, "stroke-width": "2"},
    "threshold": {"stroke": _BAD, "stroke-width": "1", "stroke-dasharray": "4 3"},
    "best": {"fill": "none", "stroke": _ACCENT, "stroke-width": "1.5"},
    "bar success": {"fill": _GOOD},
    "bar other": {"fill": "#fbe9e2", "stroke": _BAD, "stroke-width": "1"},
    "outcome": {"fill": "#ccd3d6", "stroke": "#ffffff", "stroke-width": "0.5"},
    "outcome success": {"fill": _GOOD},
    "outcome tactile": {"fill": "#d55e00"},
    "outcome error": {"fill": "#b0559b"},
    "outcome steps": {"fill": "#2f7ec0"},
    "outcome not_converged": {"fill": _STRONG},
    "outcome policy_failed": {"fill": _INK},
    "cell": {"fill": "#b5480c"},
    "marker": {"fill": _INK},
    "picture-frame": {"fill": "none", "stroke": _STRONG, "stroke-width": "1"},
}
"""Of each class, or pair of classes, of the drawings: as in `static/arena.css` and `player.css` on paper."""
MARGIN, HEAD = 12, 26
"""Around a drawing, and above it for its title [px]."""
TITLE_SIZE = 15
PARAMETER = "plot"
"""Of a page's address: key of a plot on it and format, such as `dates.pdf`."""


def find_plot_file(request: Request, figures: Iterable[Figure]) -> Response | None:
    """Return the plot that an address asks for as a file; None if it asks for none, or for one that is not there."""
    key, _, form = request.query_params.get(PARAMETER, "").rpartition(".")
    write = {"svg": (write_svg, "image/svg+xml"), "pdf": (write_pdf, "application/pdf")}.get(form)
    figure = next((figure for figure in figures if figure.key == key), None)
    if write is None or figure is None:
        return None
    named = f'attachment; filename="{re.sub(r"[^A-Za-z0-9._-]", "-", key)}.{form}"'
    return Response(
        write[0](figure), media_type=write[1], headers={"Content-Disposition": named, "Cache-Control": "no-store"}
    )


def write_svg(figure: Figure) -> bytes:
    """Return a plot as a drawing of its own, with a title and light colours."""
    width, height = _size(figure)
    rules = (
        f".{'.'.join(names.split())}{{{';'.join(f'{name}:{value}' for name, value in style.items())}}}"
        for names, style in STYLES.items()
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="Helvetica, Arial, sans-serif">'
        f"<title>{escape(figure.title)}</title><desc>{escape(figure.summary)}</desc><style>{''.join(rules)}</style>"
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>'
        f'<text x="{MARGIN}" y="{TITLE_SIZE + 4}" font-size="{TITLE_SIZE}" fill="{_INK}">{escape(figure.title)}</text>'
        f'<g transform="translate({MARGIN} {HEAD})">{figure.drawing}</g></svg>\n'
    ).encode()


def _size(figure: Figure) -> tuple[int, int]:
    return figure.width + 2 * MARGIN, figure.height + HEAD + MARGIN


def write_pdf(figure: Figure) -> bytes:
    """Return a plot as a page of its own: lines, areas and letters, no picture (ISO 32000-1).

    Letters are those of Windows' Western code page, as the fonts that every viewer has hold no others; `?` stands for
    the rest.
    """
    width, height = _size(figure)
    title = (
        f"BT {_colour(_INK)} rg /F {TITLE_SIZE} Tf 1 0 0 -1 {MARGIN} {TITLE_SIZE + 4} Tm ({_text(figure.title)}) Tj ET"
    )
    drawing = ET.fromstring(Markup("<g>{}</g>").format(figure.drawing))  # noqa: S314 - our own drawing
    operators = "\n".join([f"1 0 0 -1 0 {height} cm", title, f"1 0 0 1 {MARGIN} {HEAD} cm", *_draw(drawing)])
    content = zlib.compress(operators.encode("cp1252", "replace"))
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width} {height}] /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode(),
        f"<< /Length {len(content)} /Filter /FlateDecode >>\nstream\n".encode() + content + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        f"<< /Title ({_text(figure.title)}) >>".encode("cp1252", "replace"),
    ]
    written, places = b"%PDF-1.4\n", []
    for number, each in enumerate(objects, start=1):
        places.append(len(written))
        written += f"{number} 0 obj\n".encode() + each + b"\nendobj\n"
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    count = len(objects) + 1
    end = f"trailer\n<< /Size {count} /Root 1 0 R /Info 6 0 R >>\nstartxref\n{len(written)}\n%%EOF\n"
    return written + f"xref\n0 {count}\n0000000000 65535 f \n{table}{end}".encode()


def _draw(element: ET.Element) -> Iterator[str]:
    """Yield the operators of an element and of those in it, with y downwards."""
    if element.tag == "g":
        for child in element:
            yield from _draw(child)
    elif element.tag == "text":
        yield _write(element)
    elif element.tag != "title":
        yield from _paint(element, _outline(element))


def _style(element: ET.Element) -> dict[str, str]:
    """Return how an element is drawn, by its classes and then by its own attributes."""
    named = set(element.get("class", "").split())
    style: dict[str, str] = {}
    for classes, rules in STYLES.items():
        if named.issuperset(classes.split()):
            style |= rules
    return style | element.attrib


def _paint(element: ET.Element, outline: str) -> Iterator[str]:
    style = _style(element)
    fill, stroke = style.get("fill", "none"), style.get("stroke", "none")
    opacity = float(style.get("opacity", 1)) * float(style.get("fill-opacity", 1))
    yield f"[{style.get('stroke-dasharray', '')}] 0 d"
    if fill != "none":
        yield f"{_colour(fill, opacity)} rg"
    if stroke != "none":
        yield f"{_colour(stroke)} RG {style.get('stroke-width', '1')} w"
    yield f"{outline} {PAINTED[fill != 'none', stroke != 'none']}"


PAINTED = {(True, True): "B", (True, False): "f", (False, True): "S", (False, False): "n"}
"""Operator by whether an outline is filled, and whether it is stroked."""


def _outline(element: ET.Element) -> str:
    """Return the path of a shape."""
    at = {name: float(value) for name, value in element.attrib.items() if name in _PLACES}
    if element.tag == "rect":
        return f"{at.get('x', 0):g} {at.get('y', 0):g} {at['width']:g} {at['height']:g} re"
    if element.tag == "line":
        return _join([(at["x1"], at["y1"]), (at["x2"], at["y2"])])
    if element.tag == "circle":
        return _circle(at["cx"], at["cy"], at["r"])
    if element.tag == "path":
        return _join(_corners(element.attrib["d"]))
    raise ValueError(f"expected a rect, line, circle or path in a plot, got {element.tag}")


_PLACES = frozenset({"x", "y", "width", "height", "x1", "y1", "x2", "y2", "cx", "cy", "r"})


def _corners(path: str) -> list[tuple[float, float]]:
    """Return the corners of a path of straight lines: M and L with x and y, H with x, V with y."""
    corners: list[tuple[float, float]] = []
    for command, numbers in re.findall(r"([MLHV])([^MLHV]*)", path):
        values = [float(number) for number in re.findall(r"-?[0-9.]+", numbers)]
        x, y = corners[-1] if corners else (0.0, 0.0)
        corners.append({"H": (values[0], y), "V": (x, values[0])}.get(command, (values[0], values[-1])))
    return corners


def _join(corners: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{x:g} {y:g} {'l' if number else 'm'}" for number, (x, y) in enumerate(corners))


def _circle(x: float, y: float, r: float) -> str:
    """Return a circle as four Bezier curves, which are off by less than 0.03 % of the radius."""
    c = 0.5523 * r
    curves = (
        (x + r, y + c, x + c, y + r, x, y + r),
        (x - c, y + r, x - r, y + c, x - r, y),
        (x - r, y - c, x - c, y - r, x, y - r),
        (x + c, y - r, x + r, y - c, x + r, y),
    )
    return " ".join([f"{x + r:g} {y:g} m", *(" ".join(f"{value:g}" for value in curve) + " c" for curve in curves)])


def _write(element: ET.Element) -> str:
    style, text = _style(element), "".join(element.itertext())
    size = float(style.get("font-size", 13))
    shift = {"middle": 0.5, "end": 1.0}.get(style.get("text-anchor", ""), 0.0) * size * _width(text)
    at = f"{float(style['x']) - shift:g} {float(style['y']):g}"
    return f"BT {_colour(style.get('fill', _INK))} rg /F {size:g} Tf 1 0 0 -1 {at} Tm ({_text(text)}) Tj ET"


# Widths of Helvetica from space to tilde, in thousandths of its size (Adobe Font Metrics).
_WIDTHS = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278, 556, 556, 556, 556, 556, 556, 556,
    556, 556, 556, 278, 278, 584, 584, 584, 556, 1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833,
    722, 778, 667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556, 333, 556, 556, 500, 556,
    556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556, 556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334,
    260, 334, 584,
]  # fmt: skip


def _width(text: str) -> float:
    """Return the width of a text in multiples of its size; other letters count as a digit."""
    places = (ord(letter) - ord(" ") for letter in text)
    return sum(_WIDTHS[place] if 0 <= place < len(_WIDTHS) else 556 for place in places) / 1000


def _text(text: str) -> str:
    return re.sub(r"([\\()])", r"\\\1", text)


def _colour(name: str, opacity: float = 1.0) -> str:
    """Return a colour `#rrggbb` over white as three numbers from 0 to 1."""
    parts = (int(name[place : place + 2], 16) / 255 for place in (1, 3, 5))
    return " ".join(f"{1 - opacity * (1 - part):.3g}" for part in parts)
