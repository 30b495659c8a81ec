import os
from collections.abc import Callable
from pathlib import Path

import drawn_gels
import numpy as np
import own_sensors
import pytest
from own_sensors import block, msh, with_nodes_inside, write_sensor
from vitac.envs.sensor_design.surface import DrawnSurface
from vitac.envs.sensor_design.tetrahedra import Tetrahedra
from vitac.evaluator.sensors.check import CheckedSensor, check_sensor
from vitac.evaluator.sensors.findings import Rule, sensor_limits


def broken(check: CheckedSensor) -> list[Rule]:
    return [finding.rule for finding in check.findings if not finding.ok]


def problem(check: CheckedSensor) -> str:
    return next(finding.value + " " + finding.problem for finding in check.findings if not finding.ok)


@pytest.fixture(scope="module")
def ridge(tmp_path_factory: pytest.TempPathFactory) -> Tetrahedra:
    check = check_sensor(write_sensor(tmp_path_factory.mktemp("ridge"), drawn_gels.ridge()))
    assert check.meshed is not None
    return check.meshed.mesh


def test_bare_stl_gets_the_default_camera_and_markers(tmp_path: Path) -> None:
    (tmp_path / "sample.STL").write_bytes(drawn_gels.stl_bytes(drawn_gels.bevelled()))
    check = check_sensor(tmp_path / "sample.STL")
    assert check.ok
    assert check.design is not None
    assert len(check.design.markers_mm) == 63
    assert {finding.rule for finding in check.findings} >= set(Rule) - {
        Rule.TET_MSH,
        Rule.HEIGHT_FIELD,
        Rule.RESOLUTION,
    }


@pytest.mark.parametrize(
    "draw",
    [drawn_gels.ridge, drawn_gels.pyramids, drawn_gels.dome, lambda: drawn_gels.flat(2), lambda: drawn_gels.flat(8)],
)
def test_gels_are_accepted_with_every_marker(draw: Callable[[], DrawnSurface], tmp_path: Path) -> None:
    check = check_sensor(
        write_sensor(tmp_path, draw(), yaml="markers: {grid: {columns: 9, rows: 7, spacing_mm: [2, 2]}}")
    )
    assert check.ok, problem(check)


def test_markers_that_cannot_be_attached_are_named(tmp_path: Path) -> None:
    markers = "[[0, 0], [12.9, 0], [0, -14], [1.0, 2.0]]"
    check = check_sensor(write_sensor(tmp_path, drawn_gels.flat(), yaml=f"markers: {{points_mm: {markers}}}"))
    assert broken(check) == [Rule.MARKERS]
    assert check.meshed is not None
    assert check.design is None
    assert check.findings[-1].value == "2 of 4 attached"
    assert "2 at (12.90, 0.00) mm is not on sensing face" in check.findings[-1].problem
    assert "3 at (0.00, -14.00) mm is off the gel" in check.findings[-1].problem


def test_marker_out_of_the_picture_is_named(tmp_path: Path) -> None:
    yaml = "camera: {focal_px: [600, 325]}\nmarkers: {points_mm: [[0, 0], [9, 0]]}"
    check = check_sensor(write_sensor(tmp_path, drawn_gels.flat(), yaml=yaml))
    assert "2 at (9.00, 0.00) mm is out of picture" in problem(check)


def test_marker_behind_a_wall_is_named(tmp_path: Path) -> None:
    yaml = "markers: {points_mm: [[0, 0], [1.02, 0]]}"
    check = check_sensor(write_sensor(tmp_path, drawn_gels.ridge(), yaml=yaml))
    assert "2 at (1.02, 0.00) mm is not on sensing face" in problem(check)


def test_markers_closer_than_the_camera_can_tell_apart_are_named(tmp_path: Path) -> None:
    """Each is seen with a noise of its own: many at one place would average it away."""
    flat = write_sensor(tmp_path, drawn_gels.flat(), yaml="markers: {points_mm: [[0, 0], [2, 1], [0, 0], [2.3, 1.39]]}")
    check = check_sensor(flat)
    assert broken(check) == [Rule.MARKERS]
    assert check.design is None
    assert problem(check).startswith("4 of 4 attached, 2 too close")
    assert problem(check).endswith("3 is 0.00 mm from 1; 4 is 0.49 mm from 2.")
    for spacing_mm, faults in ((0.5, []), (0.499, [Rule.MARKERS])):
        yaml = f"markers: {{grid: {{columns: 9, rows: 7, spacing_mm: [{spacing_mm}, 0.7], rotation_deg: 31}}}}"
        assert broken(check_sensor(write_sensor(tmp_path, drawn_gels.flat(), yaml=yaml))) == faults


def test_digest_is_that_of_the_mesh_alone(tmp_path: Path, ridge: Tetrahedra) -> None:
    folders = [tmp_path / name for name in ("first", "second")]
    for folder in folders:
        folder.mkdir()
    first = check_sensor(write_sensor(folders[0], drawn_gels.ridge())).meshed
    second = check_sensor(write_sensor(folders[1], drawn_gels.moved(drawn_gels.ridge(), by=(8, 0, -4)))).meshed
    assert first is not None
    assert second is not None
    assert first.digest == second.digest


def test_mesh_of_the_team_is_taken_as_it_is(tmp_path: Path, ridge: Tetrahedra) -> None:
    check = check_sensor(write_sensor(tmp_path, drawn_gels.ridge(), mesh=msh(ridge, by_mm=(1, 2, 3))))
    assert check.ok, problem(check)
    assert check.meshed is not None
    assert check.meshed.is_own
    np.testing.assert_array_equal(check.meshed.mesh.corners, ridge.corners)
    np.testing.assert_allclose(check.meshed.mesh.nodes_mm, ridge.nodes_mm, atol=1e-9)


def changed(ridge: Tetrahedra, *, nodes_mm: np.ndarray | None = None, corners: np.ndarray | None = None) -> Tetrahedra:
    return Tetrahedra(
        nodes_mm=ridge.nodes_mm if nodes_mm is None else nodes_mm,
        corners=ridge.corners if corners is None else corners,
    )


def faulty_meshes(ridge: Tetrahedra) -> dict[str, tuple[str, Rule, str]]:
    nan, lower, moved = ridge.nodes_mm.copy(), ridge.nodes_mm.copy(), ridge.nodes_mm.copy()
    nan[3, 1] = np.nan
    lower[:, 2] *= np.where(lower[:, 2] > 3.0, 0.9, 1.0)
    moved[:, 0] *= 1.001
    turned, doubled = ridge.corners.copy(), np.concatenate([ridge.corners, ridge.corners[:1]])
    turned[5] = turned[5][[1, 0, 2, 3]]
    return {
        "no mesh": ("hello", Rule.TET_MSH, "format line"),
        "truncated": (msh(ridge)[:-300], Rule.TET_MSH, "truncated"),
        "not finite": (msh(changed(ridge, nodes_mm=nan)), Rule.TET_MSH, "not metres"),
        "millimetres": (msh(ridge, scale=1.0), Rule.TET_MSH, "not metres"),
        "inverted": (msh(changed(ridge, corners=turned)), Rule.TET_MSH, "volume of -"),
        "twice": (msh(changed(ridge, corners=doubled)), Rule.TET_MSH, "more than two"),
        "a hole": (msh(changed(ridge, corners=ridge.corners[1:])), Rule.DISTANCE, "surface of the mesh"),
        "another top": (msh(changed(ridge, nodes_mm=lower)), Rule.DISTANCE, "surface of the mesh"),
        "another base": (msh(changed(ridge, nodes_mm=moved)), Rule.BASE_NODES, "Keep the outline"),
    }


@pytest.mark.parametrize(
    "name",
    ["no mesh", "truncated", "not finite", "millimetres", "inverted", "twice", "a hole", "another top", "another base"],
)
def test_mesh_that_is_not_that_of_the_gel_is_refused(name: str, tmp_path: Path, ridge: Tetrahedra) -> None:
    text, rule, message = faulty_meshes(ridge)[name]
    check = check_sensor(write_sensor(tmp_path, drawn_gels.ridge(), mesh=text))
    assert rule in broken(check)
    finding = next(finding for finding in check.findings if finding.rule is rule)
    assert message in f"{finding.value} {finding.problem}"
    assert check.meshed is None


@pytest.mark.parametrize("counts", ["1 99999999999 1 1", "99999999999 1 1 1", "1 -1 1 1", "1 1 1 " + "9" * 5000])
def test_hostile_counts_of_a_mesh_are_refused(counts: str, tmp_path: Path) -> None:
    nodes = f"$Nodes\n{counts}\n3 1 0 99999999\n1\n$EndNodes\n"
    text = f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{nodes}$Elements\n$EndElements\n"
    assert broken(check_sensor(write_sensor(tmp_path, drawn_gels.flat(), mesh=text))) == [Rule.TET_MSH]


def test_overhang_needs_a_mesh_of_its_own(tmp_path: Path) -> None:
    void = drawn_gels.turned_inside_out(drawn_gels.moved(drawn_gels.flat(4.0), scale=0.4, by=(1, 1, 1.2)))
    check = check_sensor(write_sensor(tmp_path, drawn_gels.together(drawn_gels.flat(), void)))
    assert broken(check) == [Rule.HEIGHT_FIELD]
    assert "tet.msh" in problem(check)


def test_features_below_the_resolution_are_named(tmp_path: Path) -> None:
    comb = [[(x, -8.0), (x + 0.2, -8.0), (x + 0.2, 8.0), (x, 8.0)] for x in np.arange(-8.0, 8.0, 2.0)]
    assert broken(check_sensor(write_sensor(tmp_path, drawn_gels.pillars(comb)))) == [Rule.RESOLUTION]


def test_pipe_in_place_of_the_mesh_is_refused_without_waiting_for_it(tmp_path: Path) -> None:
    folder = write_sensor(tmp_path, drawn_gels.flat())
    os.mkfifo(folder / "tet.msh")
    check = check_sensor(folder)
    assert broken(check) == [Rule.TET_MSH]
    assert "no regular file" in problem(check)


@pytest.mark.parametrize(("height_mm", "faults"), [(1.6, []), (2.0, [Rule.REACH])])
def test_needles_that_touch_first_and_do_not_sense_are_refused(
    height_mm: float, faults: list[Rule], tmp_path: Path
) -> None:
    """Flanks of 58 and of 63 degrees: without a face that senses near the tips, no motion would end an episode."""
    drawn = drawn_gels.pyramids(half_mm=1.0, height_mm=height_mm)
    check = check_sensor(write_sensor(tmp_path, drawn, "markers: {points_mm: [[0, 0]]}\n"))
    assert broken(check) == faults
    assert (check.design is None) is bool(faults)
    if faults:
        assert "highest sensing face 2.000 mm below the highest point" in problem(check)


@pytest.mark.parametrize("gel", ["4 mm", "dome", "ridge", "pyramids"])
def test_tips_have_nodes_enough_in_our_meshes_and_are_warned_of_in_others(gel: str, tmp_path: Path) -> None:
    folder = own_sensors.write_sensor(tmp_path, own_sensors.GELS[gel](), f"markers: {own_sensors.MARKERS}\n")
    assert [finding.is_warning for finding in check_sensor(folder).findings if finding.rule is Rule.TIPS] == [False]
    plain = sensor_limits().model_copy(update={"wanted_tip_nodes": 1})
    mesh = check_sensor(folder, plain).meshed
    assert mesh is not None
    (folder / "tet.msh").write_text(own_sensors.msh(mesh.mesh))
    found = check_sensor(folder)
    (tips,) = [finding for finding in found.findings if finding.rule is Rule.TIPS]
    assert found.ok
    assert tips.ok
    assert tips.is_warning is (gel in ("ridge", "pyramids"))
    assert tips.value.startswith("4 with 1 nodes" if gel == "pyramids" else "1 with ")


def test_limits_of_a_mesh_hold_exactly(ridge: Tetrahedra, tmp_path: Path) -> None:
    folder, limits = write_sensor(tmp_path, drawn_gels.ridge(), mesh=msh(ridge)), sensor_limits()
    nodes, quality = len(ridge.nodes_mm), float(ridge.qualities.min())
    for kept in ({"min_nodes": nodes}, {"max_nodes": nodes}, {"min_quality": quality - 1e-6}):
        assert Rule.NODES not in broken(check_sensor(folder, limits.model_copy(update=kept)))
        assert Rule.QUALITY not in broken(check_sensor(folder, limits.model_copy(update=kept)))
    for name, value, rule in (
        ("min_nodes", nodes + 1, Rule.NODES),
        ("max_nodes", nodes - 1, Rule.NODES),
        ("min_quality", quality + 1e-6, Rule.QUALITY),
    ):
        assert broken(check_sensor(folder, limits.model_copy(update={name: value}))) == [rule]


def scaled(mesh: Tetrahedra, *factors: float) -> Tetrahedra:
    return Tetrahedra(nodes_mm=mesh.nodes_mm * factors, corners=mesh.corners)


def dented(by_mm: float) -> Tetrahedra:
    """A flat gel with one node of its top moved down: hardly any volume is lost."""
    mesh = block()
    inner = np.flatnonzero((mesh.nodes_mm[:, 2] == 4.0) & (np.abs(mesh.nodes_mm[:, :2]).max(axis=1) < 4.0))
    mesh.nodes_mm[inner[0], 2] -= by_mm
    return mesh


def lifted(by_mm: float) -> Tetrahedra:
    """A flat gel with one node of its base that is not at the rim moved up, and all faces around it with it."""
    mesh = block()
    inner = np.flatnonzero((mesh.nodes_mm[:, 2] == 0.0) & (np.abs(mesh.nodes_mm[:, :2]).max(axis=1) < 4.0))
    mesh.nodes_mm[inner[0], 2] += by_mm
    return mesh


# For each rule of a mesh the last value that is accepted, the first one that is refused, and a mesh with it.
MESH_BORDERS: dict[str, tuple[Rule, Callable[[float], Tetrahedra], float, float]] = {
    "fewest nodes": (Rule.NODES, lambda nodes: with_nodes_inside(block((5, 5, 3)), int(nodes) - 144), 150, 149),
    "most nodes": (Rule.NODES, lambda nodes: with_nodes_inside(block((9, 9, 9)), int(nodes) - 1000), 1000, 1001),
    "less volume": (Rule.VOLUME, lambda share: scaled(block(), 1.0, 1.0, 1.0 - share), 0.00999, 0.01001),
    "more volume": (Rule.VOLUME, lambda share: scaled(block(), 1.0, 1.0, 1.0 + share), 0.00999, 0.01001),
    "distance": (Rule.DISTANCE, dented, 0.0999, 0.1001),
    "shorter base": (Rule.BASE_NODES, lambda by: scaled(block(), 1.0 - by / 25.25, 1.0, 1.0), 0.00099, 0.00101),
    "base beside its plane": (Rule.BASE_NODES, lifted, 0.00099, 0.00101),
    "wider base": (Rule.BASE_NODES, lambda by: scaled(block(), 1.0, 1.0 + by / 20.75, 1.0), 0.00099, 0.00101),
}


@pytest.mark.parametrize("name", MESH_BORDERS)
def test_own_mesh_beside_a_limit_is_accepted_and_one_past_it_refused(name: str, tmp_path: Path) -> None:
    rule, mesh_with, accepted, refused = MESH_BORDERS[name]
    for value, expected in ((accepted, []), (refused, [rule])):
        folder = write_sensor(tmp_path, drawn_gels.flat(), mesh=msh(mesh_with(value)))
        assert broken(check_sensor(folder)) == expected, (value, problem(check_sensor(folder)))


def test_size_of_an_own_mesh_is_limited_to_the_byte(tmp_path: Path) -> None:
    text, most = msh(block()), sensor_limits().max_stl_bytes
    for n_bytes, expected in ((most, []), (most + 1, [Rule.TET_MSH])):
        folder = write_sensor(tmp_path, drawn_gels.flat(), mesh=text.ljust(n_bytes))
        assert broken(check_sensor(folder)) == expected
    assert f"expected at most {most} bytes" in problem(check_sensor(folder))


def test_mesh_that_is_glued_only_at_its_rim_is_refused(tmp_path: Path) -> None:
    """It would be softer than what was drawn, and 0.05 mm is within what surfaces may be apart."""
    mesh = block()
    inner = (mesh.nodes_mm[:, 2] == 0.0) & (np.abs(mesh.nodes_mm[:, :2]) < [12.0, 10.0]).all(axis=1)
    mesh.nodes_mm[inner, 2] = 0.05
    check = check_sensor(write_sensor(tmp_path, drawn_gels.flat(), mesh=msh(mesh)))
    assert broken(check) == [Rule.BASE_NODES]
    assert "32 nodes, outline 0.0000 mm off, 515.62 mm2 not in its plane" in problem(check)
