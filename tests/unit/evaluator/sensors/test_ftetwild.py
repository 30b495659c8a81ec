import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import drawn_gels
import numpy as np
import pytest
from vitac.envs.geometry.stl import StlError
from vitac.evaluator.sensors.findings import sensor_limits
from vitac.evaluator.sensors.ftetwild import MesherFailed, MesherMissing, mesh_with_ftetwild

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


@pytest.fixture
def stl(tmp_path: Path) -> Path:
    """A gel away from the origin, as drawing programs leave them."""
    path = tmp_path / "gel.stl"
    path.write_bytes(drawn_gels.stl_bytes(drawn_gels.moved(drawn_gels.flat(4.0), by=(30.0, 5.0, 2.0))))
    return path


class Meshed:
    """Stands for pytetwild: remembers what it got, gives one tetrahedron."""

    def __init__(self, cells: list[list[int]]) -> None:
        self.cells = cells

    def tetrahedralize(self, vertices: Any, faces: Any, **_: float) -> tuple[Any, Any]:
        self.vertices, self.faces = vertices, faces
        Path("__tracked_surface.stl").write_text("left where it runs, as fTetWild does")
        return CORNERS, np.array(self.cells).reshape(-1, 4)


def install(monkeypatch: pytest.MonkeyPatch, cells: list[list[int]]) -> Meshed:
    meshed = Meshed(cells)
    monkeypatch.setitem(sys.modules, "pytetwild", SimpleNamespace(tetrahedralize=meshed.tetrahedralize))
    return meshed


@pytest.mark.parametrize("cell", [[0, 1, 2, 3], [0, 2, 1, 3]], ids=["positive", "inverted"])
def test_gel_on_its_base_is_meshed_with_positive_volumes(
    stl: Path, monkeypatch: pytest.MonkeyPatch, cell: list[int]
) -> None:
    meshed = install(monkeypatch, [cell])
    monkeypatch.chdir(stl.parent)
    assert mesh_with_ftetwild(stl, sensor_limits()).volume_mm3 == pytest.approx(1.0 / 6.0)
    np.testing.assert_allclose(meshed.vertices.min(axis=0), [-12.625, -10.375, 0.0], atol=1e-5)
    assert meshed.faces.dtype == np.int32
    assert meshed.faces.max() == len(meshed.vertices) - 1
    assert list(stl.parent.iterdir()) == [stl]


def test_mesher_that_gives_nothing_is_named(stl: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, [])
    with pytest.raises(MesherFailed, match="vitac sensor check"):
        mesh_with_ftetwild(stl, sensor_limits())


def test_mesher_that_is_not_installed_says_how_to_install_it(stl: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pytetwild", None)
    with pytest.raises(MesherMissing, match="pip install pytetwild"):
        mesh_with_ftetwild(stl, sensor_limits())


def test_file_that_is_no_stl_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, [])
    (tmp_path / "gel.stl").write_text("junk")
    with pytest.raises(StlError):
        mesh_with_ftetwild(tmp_path / "gel.stl", sensor_limits())
