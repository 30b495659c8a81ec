"""Plots saved as SVG and PDF: readable alone, and the same in both."""

import re
import zlib
from datetime import UTC, datetime, timedelta
from uuid import uuid4
from xml.etree import ElementTree as ET

import pytest
from page_fixtures import a_score, some_episodes
from starlette.requests import Request
from vitac.server.views.leaderboards import DatedRankView, TeamRanksView
from vitac.web.plots.axis import Figure, Table, element
from vitac.web.plots.dates import DatedValue, ranks_by_date, values_by_date
from vitac.web.plots.episodes import offset_maps, steps_histogram, success_by_shape
from vitac.web.plots.files import STYLES, find_plot_file, write_pdf, write_svg
from vitac.web.plots.sensors import marker_picture, quality_histogram

BEGUN = datetime(2026, 3, 1, tzinfo=UTC)


def all_plots() -> list[Figure]:
    ends = some_episodes("peg-insertion", 270)
    rates = [DatedValue(name=f"<{n}>", at=BEGUN + timedelta(days=n), value=n / 9, own=n == 2) for n in range(9)]
    ranks = TeamRanksView(team="Ants & (Bees)", submission_id=uuid4(), ranks=[DatedRankView(at=BEGUN, rank=1)])
    return [
        *offset_maps("track_1", "peg-insertion", {end.episode: end for end in ends}),
        steps_histogram("peg-insertion", ends),
        success_by_shape(a_score((75, 78, 58), 4.16)),
        values_by_date("dates", "Success rate against date", rates),
        ranks_by_date("ranks", "Rank", [ranks], BEGUN + timedelta(days=9)),
        quality_histogram("1", [1, 4, 9]),
        marker_picture("1", [(10.0, 20.0), (30.0, 40.0)]),
    ]


def page_of(pdf: bytes) -> str:
    """Return the operators of the page, as every object stands where the table of the file says."""
    table = [int(place) for place in re.findall(rb"^(\d{10}) 00000 n", pdf, re.MULTILINE)]
    assert [pdf[place:].split(b" ")[0] for place in table] == [b"%d" % (number + 1) for number in range(len(table))]
    [content] = re.findall(rb"stream\n(.*)\nendstream", pdf, re.DOTALL)
    return zlib.decompress(content).decode("cp1252")


@pytest.mark.parametrize("figure", all_plots(), ids=lambda figure: figure.key)
def test_every_plot_is_a_drawing_and_a_page_with_the_same_shapes_and_words(figure: Figure) -> None:
    svg = ET.fromstring(write_svg(figure))  # noqa: S314 - our own
    drawn = [one for one in svg.iter() if one.tag.endswith(("rect", "circle", "line", "path"))][1:]  # after the paper
    words = ["".join(one.itertext()) for one in svg.iter() if one.tag.endswith("text")]
    classes = {name for one in svg.iter() for name in one.get("class", "").split() if not name.startswith("rank-")}
    assert classes <= {name for names in STYLES for name in names.split()}  # nothing is left black
    operators = page_of(write_pdf(figure))
    assert len(re.findall(r" (?:B|f|S)$", operators, re.MULTILINE)) == len(drawn)
    shown = [re.sub(r"\\(.)", r"\1", text) for text in re.findall(r"\((.*)\) Tj", operators)]
    assert shown == words
    assert figure.title in words


def test_areas_lie_where_the_drawing_has_them_and_fade_towards_white() -> None:
    drawing = element("rect", class_="cell", x=1, y=2, width=3, height=4, fill_opacity=0.0) + element(
        "text", "end", class_="tick", x=50, y=9, text_anchor="end"
    )
    figure = Figure(
        key="a",
        title="Ä 東",
        summary="",
        width=60,
        height=40,
        drawing=drawing,
        table=Table(columns=(), rows=()),
    )
    operators = page_of(write_pdf(figure)).splitlines()
    assert operators[0] == "1 0 0 -1 0 78 cm"  # 40 high, with head and margin; y downwards
    assert "(Ä ?) Tj" in operators[1]
    assert operators[-3:-1] == ["1 1 1 rg", "1 2 3 4 re f"]
    assert "1 0 0 -1 31.652 9 Tm" in operators[-1]  # `end` is 1.668 times 11 px wide


@pytest.mark.parametrize(
    ("asked", "media"),
    [("dates.svg", "image/svg+xml"), ("dates.pdf", "application/pdf"), ("dates.png", None), ("x.svg", None)],
)
def test_an_address_names_the_plot_and_the_format(asked: str, media: str | None) -> None:
    request = Request({"type": "http", "query_string": f"task=a&plot={asked}".encode(), "headers": []})
    answer = find_plot_file(request, all_plots())
    assert (answer and answer.media_type) == media
    if answer:
        assert answer.headers["Content-Disposition"] == f'attachment; filename="{asked}"'
