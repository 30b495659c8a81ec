import re
from dataclasses import replace

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import an_id
from page_service import FixedData
from shown_sensors import a_shown_sensor
from visits import COMPLETED, QUEUED, RUNNING, sign_in

ADDRESS = f"/submissions/{COMPLETED.id}/sensor"


@pytest.fixture
def shown(data: FixedData, browser: AsgiBrowser) -> AsgiBrowser:
    """Somebody of the Gelbots, whose submissions have sensors; the second one is not measured yet."""
    data.sensors[COMPLETED.id] = a_shown_sensor(COMPLETED.id)
    data.sensors[RUNNING.id] = a_shown_sensor(RUNNING.id, name="runs", gel="dome", figures=None, gain=None)
    sign_in(browser, "Gelbots")
    return browser


def test_page_shows_gel_mesh_markers_maps_and_figures(shown: AsgiBrowser) -> None:
    html = shown.get(ADDRESS).text
    for said in (
        "Quality of the tetrahedra",
        "Markers in the camera",
        "Sensitivity to normal force",
        "Sensitivity to shear force",
        "force at the grasp [N]",
        "standard score, friction -30 % [%]",
        "Reference gel",
        "measured at 90 starts",
        "+6.7",
        "(+3.0 to +10.0, exact p = 4e-06)",
        f'data-shape="{ADDRESS}/shape"',
        'href="/docs/sensors#figures"',
        f'<a href="/submissions/{COMPLETED.id}/document" download>design-document.pdf<',
        "9 Bytes, to save",
    ):
        assert said in html
    assert html.count('<polygon points="') > 50
    assert 'data-shape="/sensors/reference/shape"' in html, "the reference gel stands beside it"
    assert "Heights are drawn 3 times as large." in html
    assert set(shown.get("/sensors/reference/shape").json()) == set(shown.get(f"{ADDRESS}/shape").json())


def test_two_sensors_stand_side_by_side(shown: AsgiBrowser) -> None:
    html = shown.get(f"{ADDRESS}?beside={RUNNING.id}").text
    assert 'class="players two"' in html
    assert html.count('class="player gel"') == 2
    assert "runs: not measured yet." in html
    assert len(re.findall(r"Sensitivity to normal force, 0 to \S+ px/N</figcaption>", html)) == 1
    assert html.count('<th scope="col">runs</th>') == 1


def test_shape_for_the_script_has_vertices_triangles_and_kinds(shown: AsgiBrowser) -> None:
    answer = shown.get(f"{ADDRESS}/shape")
    found = answer.json()
    assert set(found) == {"vertices_mm", "triangles", "kinds", "markers_mm", "height_scale"}
    assert len(found["triangles"]) == len(found["kinds"])
    assert max(max(row) for row in found["triangles"]) == len(found["vertices_mm"]) - 1
    assert answer.headers["vary"] == "Cookie"


def test_design_document_is_a_file_to_save_and_never_shown(shown: AsgiBrowser) -> None:
    answer = shown.get(f"/submissions/{COMPLETED.id}/document")
    assert (answer.status_code, answer.content) == (200, b"<script>")
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["content-disposition"] == f'attachment; filename="{COMPLETED.id}-design-document.pdf"'
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["content-security-policy"] == "sandbox; default-src 'none'"
    assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("beside", [str(QUEUED.id), str(an_id("nobody")), "not-an-id", "<script>"])
def test_sensor_of_others_is_as_if_missing(shown: AsgiBrowser, beside: str) -> None:
    assert shown.get(ADDRESS, params={"beside": beside}).status_code == 404
    assert shown.get(f"/submissions/{beside}/sensor").status_code == 404
    assert shown.get(f"/submissions/{beside}/sensor/shape").status_code == 404
    assert shown.get(f"/submissions/{beside}/document").status_code == 404


def test_the_sensor_of_a_public_result_is_shown_to_everybody_without_its_document(
    data: FixedData, browser: AsgiBrowser
) -> None:
    data.sensors[COMPLETED.id] = replace(a_shown_sensor(COMPLETED.id), has_document=False)
    data.found = [found.model_copy(update={"public": found.id == COMPLETED.id}) for found in data.found]
    html = browser.get(ADDRESS).text
    for part in ("Reference gel", "<dt>Markers</dt>", "<dt>Sensing gain</dt>", 'data-shape="/sensors/reference/shape"'):
        assert part in html
    assert "Design document" not in html
    assert browser.get(f"{ADDRESS}/shape").status_code == 200
    assert browser.get(f"/submissions/{COMPLETED.id}/document").status_code == 303


def test_who_is_not_signed_in_is_sent_to_the_sign_in(browser: AsgiBrowser) -> None:
    for address in (ADDRESS, f"{ADDRESS}/shape", f"/submissions/{COMPLETED.id}/document"):
        answer = browser.get(address)
        assert answer.status_code == 303
        assert answer.headers["location"].startswith("/sign-in")
