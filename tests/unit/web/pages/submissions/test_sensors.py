import re
from collections.abc import Iterator
from uuid import UUID

import pytest
from seeded_site import BEARS, GELBOTS, SeededSite, seeded_site
from shown_sensors import DOCUMENT, play_and_measure, upload_sensor
from vitac.server.leaderboards.public_pages import set_public


@pytest.fixture(scope="module")
def site() -> Iterator[SeededSite]:
    """A service with two sensors of the Gelbots, of which the second is not measured, and a public one of the Bears."""
    with seeded_site() as site:
        for team, name, gel in ((GELBOTS, "ridge", "ridge"), (GELBOTS, "dome", "dome"), (BEARS, "flat", "4 mm")):
            upload_sensor(site, team, name, gel)
        for name in ("ridge", "flat"):
            play_and_measure(site, name)
        with site.database.transaction() as session:
            set_public(session, site.seed.people[BEARS], site.id_of("flat"), public=True)
        yield site


@pytest.fixture
def page(site: SeededSite) -> str:
    return f"{site.path_of('ridge')}/sensor"


def test_page_shows_gel_mesh_markers_maps_and_figures(site: SeededSite, page: str) -> None:
    browser = site.visitor(GELBOTS)
    html = browser.get(page).text
    for said in (
        "Quality of the tetrahedra",
        "Markers in the camera",
        "Sensitivity to normal force",
        "Sensitivity to shear force",
        "force at the grasp [N]",
        "Reference gel",
        "+6.7",
        "exact p = ",
        f'data-shape="{page}/shape"',
        'href="/docs/sensors#figures"',
        f'<a href="{site.path_of("ridge")}/document" download>design-document.pdf<',
        f"{len(DOCUMENT)} Bytes, to save",
    ):
        assert said in html, said
    assert html.count('<polygon points="') > 50
    assert 'data-shape="/sensors/reference/shape"' in html, "the reference gel stands beside it"
    assert "Heights are drawn 3 times as large." in html


def test_two_sensors_stand_side_by_side(site: SeededSite, page: str) -> None:
    html = site.visitor(GELBOTS).get(f"{page}?beside={site.id_of('dome')}").text
    assert 'class="players two"' in html
    assert html.count('class="player gel"') == 2
    assert "dome: not measured yet." in html
    assert len(re.findall(r"Sensitivity to normal force, 0 to \S+ px/N</figcaption>", html)) == 1
    assert html.count('<th scope="col">dome</th>') == 1


def test_shape_for_the_script_has_vertices_triangles_and_kinds(site: SeededSite, page: str) -> None:
    browser = site.visitor(GELBOTS)
    answer = browser.get(f"{page}/shape")
    shape = answer.json()
    assert shape.keys() == {"vertices_mm", "triangles", "kinds", "markers_mm", "height_scale"}
    assert browser.get("/sensors/reference/shape").json().keys() == shape.keys()
    assert len(shape["triangles"]) == len(shape["kinds"])
    assert max(max(row) for row in shape["triangles"]) == len(shape["vertices_mm"]) - 1
    assert answer.headers["vary"] == "Cookie"


def test_design_document_is_a_file_to_save_and_never_shown(site: SeededSite) -> None:
    answer = site.visitor(GELBOTS).get(f"{site.path_of('ridge')}/document")
    assert (answer.status_code, answer.content) == (200, DOCUMENT)
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["content-disposition"] == f'attachment; filename="{site.id_of("ridge")}-design-document.pdf"'
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["content-security-policy"] == "sandbox; default-src 'none'"
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("other", ["ridge", str(UUID(int=7)), "not-an-id", "<script>"])
def test_sensor_of_others_is_as_if_missing(site: SeededSite, other: str) -> None:
    browser = site.visitor(BEARS)
    identity = str(site.added.get(other, other))
    assert browser.get(f"{site.path_of('flat')}/sensor", params={"beside": identity}).status_code == 404
    for part in ("sensor", "sensor/shape", "document"):
        assert browser.get(f"/submissions/{identity}/{part}").status_code == 404


def test_the_sensor_of_a_public_result_is_shown_to_everybody_without_its_document(site: SeededSite, page: str) -> None:
    visitor, public = site.visitor(), site.path_of("flat")
    html = visitor.get(f"{public}/sensor").text
    for part in ("Reference gel", "<dt>Markers</dt>", "<dt>Sensing gain</dt>", 'data-shape="/sensors/reference/shape"'):
        assert part in html
    assert "Design document" not in html
    assert visitor.get(f"{public}/sensor/shape").status_code == 200
    for address in (f"{public}/document", page, f"{page}/shape"):
        answer = visitor.get(address)
        assert answer.status_code == 303
        assert answer.headers["location"].startswith("/sign-in")
