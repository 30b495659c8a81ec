"""The page of a submission's sensor, alone or beside another one: gel, mesh, markers, sensitivity, figures."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from uuid import UUID

from markupsafe import Markup
from sqlalchemy.orm import Session
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.figures.table import make_rows, reference_figures, reference_looks
from vitac.evaluator.sensors.appearance import Appearance, appearance
from vitac.evaluator.sensors.made import read_made_sensor
from vitac.server.accounts.shown_names import ShownNames
from vitac.server.leaderboards.public_pages import readable
from vitac.server.principals import Principal
from vitac.server.submissions import sensors
from vitac.server.views.submissions import SensorView

from ...plots.axis import Figure
from ...plots.files import find_plot_file
from ...plots.sensors import HEIGHT_SCALE, find_largest, marker_picture, quality_histogram, sensitivity_maps, still
from ...site import Site, get_principal, get_site, get_viewer, open_to_all, page, require_viewer
from ..addresses import as_id
from ..episodes import player_script


@dataclass(frozen=True, kw_only=True)
class ShownSensor:
    """What a page shows of the sensor of a submission.

    Attributes:
        submission_id: of the submission.
        name: of the submission.
        team: of the submission.
        view: mesh, document, gain and figures.
        looks: gel, quality and markers.
        has_document: whether the visitor may have the design document, which is never public.
    """

    submission_id: UUID
    name: str
    team: str
    view: SensorView
    looks: Appearance
    has_document: bool = True


@dataclass(frozen=True, kw_only=True)
class SensorOnPage:
    """One sensor of the page.

    Attributes:
        shown: the sensor.
        still: its gel as a drawing.
        figures: its plots.
    """

    shown: ShownSensor
    still: Markup
    figures: Sequence[Figure]


@dataclass(frozen=True, kw_only=True)
class ReferenceOnPage:
    """The reference gel: as a drawing, and its markers."""

    still: Markup
    figure: Figure


@open_to_all
async def sensor(request: Request) -> Response:
    """Show the sensor of a submission, of a public one to everybody, beside that of another one if the address says."""
    viewer, site = await get_viewer(request), get_site(request)
    beside = request.query_params.get("beside", "").strip()
    ids = [as_id(text) for text in (request.path_params["submission_id"], *([beside] if beside else ()))]
    shown = [await _shown_sensor(site, get_principal(viewer), submission_id) for submission_id in ids]
    largest = _largest([view.view.figures for view in shown])
    parts = [_part(number, view, largest) for number, view in enumerate(shown, start=1)]
    reference = None if beside else _reference()
    drawn = [figure for part in parts for figure in part.figures]
    if plot := find_plot_file(request, drawn if reference is None else [*drawn, reference.figure]):
        return plot
    return page(
        request,
        "sensor.html",
        viewer=viewer,
        section="/submissions" if viewer else "",
        parts=parts,
        reference=reference,
        height_scale=HEIGHT_SCALE,
        rows=_rows([view.view.figures for view in shown]),
        beside=beside,
        player_script=player_script(),
    )


@open_to_all
async def shape(request: Request) -> Response:
    """Answer with the gel of a submission's sensor, for the page's script; it never changes."""
    viewer = await get_viewer(request)
    submission_id = as_id(request.path_params["submission_id"])
    shown = await _shown_sensor(get_site(request), get_principal(viewer), submission_id)
    return JSONResponse(_shape(shown.looks), headers={"Cache-Control": "private, max-age=3600", "Vary": "Cookie"})


@open_to_all
async def reference_shape(_: Request) -> Response:
    """Answer with the reference gel, beside which a sensor is shown."""
    return JSONResponse(_shape(reference_looks()), headers={"Cache-Control": "public, max-age=3600"})


def _shape(looks: Appearance) -> dict[str, object]:
    content = looks.model_dump(mode="json", include={"vertices_mm", "triangles", "kinds", "markers_mm"})
    return content | {"height_scale": HEIGHT_SCALE}


async def document(request: Request) -> Response:
    """Return the design document of a submission as a file to save."""
    viewer = await require_viewer(request)
    submission_id = as_id(request.path_params["submission_id"])
    site = get_site(request)
    file = await site.ask(lambda session: sensors.document(session, viewer.principal, submission_id))
    content = await asyncio.to_thread(site.services.blobs.read, file.sha256)
    return Response(content, headers=sensors.to_save(submission_id, file) | {"Cache-Control": "no-store"})


async def _shown_sensor(site: Site, by: Principal, submission_id: UUID) -> ShownSensor:
    """Return the sensor of a submission; its file is read outside the transaction."""

    def read(session: Session) -> tuple[SensorView, str, str, bool]:
        submission = readable(session, by, submission_id)
        team = ShownNames.read(session, by).show_name(submission.team)
        has_document = by.may_see(submission.team_id, submission.competition)
        return sensors.sensor(session, by, submission), submission.name, team, has_document

    view, name, team, has_document = await site.ask(read)
    content = await asyncio.to_thread(site.services.blobs.read, view.digest)
    looks = await asyncio.to_thread(lambda: appearance(read_made_sensor(content)))
    return ShownSensor(
        submission_id=submission_id, name=name, team=team, view=view, looks=looks, has_document=has_document
    )


def _part(number: int, shown: ShownSensor, largest: tuple[float, float]) -> SensorOnPage:
    key, figures = str(number), shown.view.figures
    maps = () if figures is None else sensitivity_maps(key, figures.touch.sensitivity, largest)
    return SensorOnPage(
        shown=shown,
        still=still(shown.looks),
        figures=(marker_picture(key, shown.looks.markers_px), quality_histogram(key, shown.looks.qualities), *maps),
    )


def _reference() -> ReferenceOnPage:
    looks = reference_looks()
    return ReferenceOnPage(still=still(looks), figure=marker_picture("reference", looks.markers_px))


def _largest(figures: Sequence[SensorFigures | None]) -> tuple[float, float]:
    """Return the ends of the scales that all maps of the page share."""
    maps = [of_gel.touch.sensitivity for of_gel in figures if of_gel is not None]
    return find_largest(*(drawn.normal_px_n for drawn in maps)), find_largest(*(drawn.shear_px_n for drawn in maps))


def _rows(figures: Sequence[SensorFigures | None]) -> list[tuple[str, ...]]:
    """Return the table of the figures: name and unit, the value of each sensor, and that of the reference gel."""
    reference = reference_figures()
    columns = [
        {} if of_gel is None else {row.name: row.value for row in make_rows(of_gel, reference)} for of_gel in figures
    ]
    return [
        (
            f"{row.name} [{row.unit}]" if row.unit else row.name,
            *(_text(column.get(row.name)) for column in columns),
            _text(row.value),
        )
        for row in make_rows(reference, reference)
    ]


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
