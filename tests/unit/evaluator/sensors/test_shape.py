import os
import re
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import drawn_gels
import numpy as np
import pytest
from vitac.envs.sensor_design.surface import DrawnSurface
from vitac.evaluator.sensors.findings import Rule, sensor_limits
from vitac.evaluator.sensors.shape import ShapeCheck

LIMITS = sensor_limits()


def checked(content: bytes | DrawnSurface, folder: Path) -> ShapeCheck:
    path = folder / "gel.stl"
    path.write_bytes(content if isinstance(content, bytes) else drawn_gels.stl_bytes(content))
    return ShapeCheck(path, LIMITS)


def broken(check: ShapeCheck) -> list[Rule]:
    return [finding.rule for finding in check.findings if not finding.ok]


@pytest.mark.parametrize(
    "draw", [drawn_gels.flat, drawn_gels.bevelled, drawn_gels.ridge, drawn_gels.pyramids, drawn_gels.dome]
)
def test_sound_gel_keeps_to_all_rules(draw: Callable[[], DrawnSurface], tmp_path: Path) -> None:
    check = checked(drawn_gels.moved(draw(), by=(-25.25, -20.75, -4)), tmp_path)
    assert broken(check) == []
    assert check.surface is not None
    assert check.surface.volume_mm3 == pytest.approx(draw().volume_mm3, rel=1e-5)


def opened() -> DrawnSurface:
    gel = drawn_gels.flat()
    return DrawnSurface(vertices_mm=gel.vertices_mm, triangles=gel.triangles[1:])


def mixed() -> DrawnSurface:
    gel = drawn_gels.flat()
    gel.triangles[3] = gel.triangles[3][::-1]
    return gel


def with_fin() -> DrawnSurface:
    gel = drawn_gels.flat()
    a, b = gel.triangles[0, :2].tolist()
    fins = np.array([[a, b, len(gel.vertices_mm)], [b, a, len(gel.vertices_mm)]])
    vertices = np.concatenate([gel.vertices_mm, [[0.0, 0.0, 6.0]]])
    return DrawnSurface(vertices_mm=vertices, triangles=np.concatenate([gel.triangles, fins]))


def sheet() -> DrawnSurface:
    return drawn_gels.flat(1e-4)


def two_bodies() -> DrawnSurface:
    return drawn_gels.together(drawn_gels.flat(2.0), drawn_gels.moved(drawn_gels.flat(2.0), by=(0, 0, 4)))


def crossed() -> DrawnSurface:
    gel = drawn_gels.pyramids()
    gel.vertices_mm[gel.vertices_mm[:, 2].argmax(), 2] = -1.0
    return gel


def with_infinity() -> DrawnSurface:
    gel = drawn_gels.flat()
    gel.vertices_mm[0, 0] = np.inf
    return gel


def with_nan() -> DrawnSurface:
    gel = drawn_gels.flat()
    gel.vertices_mm[0, 0] = np.nan
    return gel


FAULTS: dict[str, tuple[Callable[[], DrawnSurface], Rule, str]] = {
    "open": (opened, Rule.CLOSED, "Close the holes"),
    "mixed": (mixed, Rule.ORIENTATION, "make the normals consistent"),
    "fin": (with_fin, Rule.EDGES, "More than two triangles"),
    "inverted": (lambda: drawn_gels.turned_inside_out(drawn_gels.flat()), Rule.INVERTED, "flip the normals"),
    "flat": (sheet, Rule.FLAT, "sheet"),
    "two bodies": (two_bodies, Rule.BODIES, "loose parts"),
    "crossing": (crossed, Rule.SELF_INTERSECTION, r"cross near \("),
    "infinite": (with_infinity, Rule.FINITE, "infinite, too large or no number"),
    "no number": (with_nan, Rule.FINITE, "infinite, too large or no number"),
    "metres": (lambda: drawn_gels.moved(drawn_gels.flat(), scale=1e-3), Rule.UNIT, "in metres"),
    "inches": (lambda: drawn_gels.moved(drawn_gels.flat(), scale=1 / 25.4), Rule.UNIT, "in inches"),
    "too large": (lambda: drawn_gels.moved(drawn_gels.flat(), scale=7.0), Rule.UNIT, "in millimetres"),
    "longer": (lambda: drawn_gels.stretched(drawn_gels.flat(), (1.001, 1, 1)), Rule.BASE_LENGTH, "case takes"),
    "wider": (lambda: drawn_gels.stretched(drawn_gels.flat(), (1, 1.002, 1)), Rule.BASE_WIDTH, "case takes"),
    "thin": (lambda: drawn_gels.flat(1.9), Rule.THICKNESS, "height"),
    "thick": (lambda: drawn_gels.flat(8.1), Rule.THICKNESS, "height"),
    "upside down": (
        lambda: drawn_gels.turned_inside_out(drawn_gels.stretched(drawn_gels.ridge(), (1, 1, -1))),
        Rule.BASE_LENGTH,
        r"towards \+z",
    ),
    "pocket in the base": (
        lambda: drawn_gels.turned_inside_out(drawn_gels.stretched(drawn_gels.pit(), (1, 1, -1))),
        Rule.BASE_FLAT,
        "flat rectangle",
    ),
    "wider above": (lambda: drawn_gels.leaning(0.1), Rule.BEYOND_BASE, "stand out"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_has_its_own_reason(name: str, tmp_path: Path) -> None:
    draw, rule, advice = FAULTS[name]
    check = checked(draw(), tmp_path)
    assert check.surface is None
    assert broken(check)[0] is rule
    (finding,) = [finding for finding in check.findings if finding.rule is rule and not finding.ok]
    assert finding.problem
    assert re.search(advice, finding.problem)


def test_base_within_tolerance_is_accepted(tmp_path: Path) -> None:
    assert broken(checked(drawn_gels.stretched(drawn_gels.flat(), (1.0007, 0.9991, 1)), tmp_path)) == []


def test_cavity_is_part_of_one_body(tmp_path: Path) -> None:
    void = drawn_gels.turned_inside_out(drawn_gels.moved(drawn_gels.flat(4.0), scale=0.4, by=(1, 1, 1.2)))
    assert broken(checked(drawn_gels.together(drawn_gels.flat(), void), tmp_path)) == []


def test_inverted_body_beside_the_gel_is_no_cavity(tmp_path: Path) -> None:
    loose = drawn_gels.turned_inside_out(drawn_gels.moved(drawn_gels.flat(4.0), scale=0.4, by=(0, 0, 6)))
    assert broken(checked(drawn_gels.together(drawn_gels.flat(), loose), tmp_path)) == [Rule.BODIES]


def test_too_many_triangles_are_refused_before_they_are_parsed(tmp_path: Path) -> None:
    check = checked(drawn_gels.dome(cells=110), tmp_path)
    assert broken(check) == [Rule.TRIANGLES]
    assert "49280 triangles" in check.findings[0].problem
    ascii_stl = b"solid\n" + b"vertex 0 0 0\n" * (3 * (LIMITS.max_triangles + 1))
    assert broken(checked(ascii_stl, tmp_path)) == [Rule.TRIANGLES]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"solid",
        b"\x00" * 84,
        drawn_gels.stl_bytes(drawn_gels.flat())[:-1],
        b"\x00" * 80 + b"\xff\xff\xff\xff" + b"\x00" * 50,
        b"solid\nvertex 1 2\nendsolid",
        b"solid\nvertex one two three\nendsolid",
        b"a" * (LIMITS.max_stl_bytes + 1),
    ],
)
def test_what_is_no_stl_is_unreadable(content: bytes, tmp_path: Path) -> None:
    assert broken(checked(content, tmp_path)) == [Rule.READABLE]


@pytest.mark.parametrize(("number", "rule"), [("1e400", Rule.FINITE), ("1e308", Rule.FINITE), ("9e29", Rule.UNIT)])
def test_numbers_that_could_not_be_squared_are_refused(number: str, rule: Rule, tmp_path: Path) -> None:
    text = f"solid\nvertex 0 0 0\nvertex -{number} 0 0\nvertex {number} 1 0\nendsolid"
    assert broken(checked(text.encode(), tmp_path)) == [rule]


def test_missing_file_is_unreadable(tmp_path: Path) -> None:
    assert broken(ShapeCheck(tmp_path / "gel.stl", LIMITS)) == [Rule.READABLE]
    (tmp_path / "gel.stl").mkdir()
    assert broken(ShapeCheck(tmp_path / "gel.stl", LIMITS)) == [Rule.READABLE]


def test_pipe_is_unreadable_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "gel.stl")
    check = ShapeCheck(tmp_path / "gel.stl", LIMITS)
    assert broken(check) == [Rule.READABLE]
    assert "no regular file" in check.findings[0].problem


def test_long_text_with_few_vertices_takes_little_memory(tmp_path: Path) -> None:
    text = b"solid vertex 1 2 3 " + b"a " * (LIMITS.max_stl_bytes // 2 - 10)
    tracemalloc.start()
    try:
        check = checked(text, tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 2**25
    finally:
        tracemalloc.stop()
    assert broken(check) == [Rule.READABLE]


def test_more_near_pairs_than_can_be_compared_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.evaluator.sensors.shape._MAX_PAIRS", 100)
    check = checked(drawn_gels.dome(), tmp_path)
    assert broken(check) == [Rule.TRIANGLES]
    assert "pairs of near triangles" in check.findings[-1].value


# Just inside and just outside of each limit; STL files keep 24 bits of a number.
BORDERS: dict[Rule, tuple[Callable[[float], DrawnSurface], float, float]] = {
    Rule.BASE_LENGTH: (lambda by: drawn_gels.stretched(drawn_gels.flat(), (1 + by / 25.25, 1, 1)), 0.0199, 0.0202),
    Rule.BASE_WIDTH: (lambda by: drawn_gels.stretched(drawn_gels.flat(), (1, 1 - by / 20.75, 1)), 0.0199, 0.0202),
    Rule.BEYOND_BASE: (drawn_gels.leaning, 0.019, 0.021),
    Rule.UNIT: (lambda length: drawn_gels.moved(drawn_gels.flat(), scale=length / 25.25), 39.9, 40.1),
}


@pytest.mark.parametrize("rule", BORDERS)
def test_value_beside_a_limit_is_accepted_and_one_past_it_refused(rule: Rule, tmp_path: Path) -> None:
    draw, inside, outside = BORDERS[rule]
    assert rule not in broken(checked(draw(inside), tmp_path))
    assert broken(checked(draw(outside), tmp_path))[0] is rule


@pytest.mark.parametrize(("thickness_mm", "fits"), [(1.999, False), (2.0, True), (8.0, True), (8.001, False)])
def test_thickness_is_from_two_to_eight_millimetres(thickness_mm: float, fits: bool, tmp_path: Path) -> None:
    assert broken(checked(drawn_gels.flat(thickness_mm), tmp_path)) == ([] if fits else [Rule.THICKNESS])


def test_number_of_triangles_is_limited_exactly(tmp_path: Path) -> None:
    record = drawn_gels.stl_bytes(drawn_gels.flat())[84:134]
    for count, rule in ((LIMITS.max_triangles, None), (LIMITS.max_triangles + 1, Rule.TRIANGLES)):
        found = checked(b"\0" * 80 + count.to_bytes(4, "little") + record * count, tmp_path)
        assert (Rule.TRIANGLES in broken(found)) is (rule is not None)


def test_size_of_the_file_is_limited_to_the_byte(tmp_path: Path) -> None:
    rows = [f"vertex {x!r} {y!r} {z!r}" for x, y, z in drawn_gels.flat().corners_mm.reshape(-1, 3).tolist()]
    text = "\n".join(["solid gel", *rows, "endsolid gel"]).encode()
    for n_bytes, faults in ((LIMITS.max_stl_bytes, []), (LIMITS.max_stl_bytes + 1, [Rule.READABLE])):
        assert broken(checked(text.ljust(n_bytes), tmp_path)) == faults
