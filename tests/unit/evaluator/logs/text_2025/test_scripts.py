"""The lists of the four scripts of 2025, without any log."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.logs.text_2025.scripts import PRINTED_MM, Script, all_scripts, find_script, is_printed

SCRIPTS = {script.name: script for script in all_scripts()}
PEG, LOCK = SCRIPTS["track 1 peg insertion"], SCRIPTS["track 1 lock opening"]
VISION = SCRIPTS["track 2 peg insertion"]


@pytest.mark.parametrize("script", all_scripts(), ids=lambda script: script.name)
def test_every_start_of_a_list_is_found_by_what_a_log_prints(script: Script) -> None:
    for start in script.starts():
        found = script.find_start(start.shape, start.offset)
        assert found is not None
        assert (found.shape, found.offset) == (start.shape, start.offset)


def test_a_start_that_is_in_no_list_is_not_found() -> None:
    assert PEG.find_start("cuboid", (-4.0, -4.0, -7.0)) is None
    assert PEG.find_start("hexagon", (-4.0, -4.0, -8.0)) is None
    assert PEG.find_start("cuboid", (-4.0, -4.0)) is None


def test_shapes_change_fastest_then_offsets_then_repeats() -> None:
    starts = PEG.starts()
    assert [start.shape for start in starts[:4]] == ["cuboid", "trapezoid", "concave1", "cuboid"]
    assert [start.offset_index for start in starts[:6]] == [0, 0, 0, 1, 1, 1]
    assert [start.repeat_index for start in starts[89:91]] == [0, 1]


def test_vision_starts_are_shown_from_the_hole_and_counted_from_the_real_rim() -> None:
    first_top_mm, real_top_mm = VISION.hole_tops_mm[0], VISION.hole_tops_mm[-1]
    early, late = VISION.starts(first_top_mm)[0], VISION.starts(real_top_mm)[0]
    x, y, theta, z, left = early.listed_offset
    assert early.offset == pytest.approx((x, y + 22.625 - (45.25 if left else 0.0), theta, z + first_top_mm - 6.9))
    assert early.true_offset == pytest.approx((x, y, theta, z + first_top_mm - real_top_mm, left))
    assert late.true_offset == late.listed_offset
    assert VISION.starts() == VISION.starts(first_top_mm)


def test_a_part_is_named_without_its_side() -> None:
    assert {start.part for start in VISION.starts()} == {start.shape.split("(")[0] for start in VISION.starts()}
    assert all("(" not in start.part for script in all_scripts() for start in script.starts())


def test_a_script_is_recognised_by_a_key_that_only_it_prints() -> None:
    for script in all_scripts():
        assert find_script(script.environment, has_md5=bool(script.md5)) == script
    assert find_script({}) is None
    assert find_script({"max_steps": 8}) is None


@given(st.lists(st.floats(-100.0, 100.0), max_size=5), st.floats(-0.99, 0.99))
def test_printing_may_round(numbers: list[float], part: float) -> None:
    assert is_printed([number + part * PRINTED_MM for number in numbers], numbers)
    assert not is_printed([*numbers, 0.0], numbers)
    if numbers:
        assert not is_printed([*numbers[:-1], numbers[-1] + 2 * PRINTED_MM + 1e-6], numbers)


@pytest.mark.parametrize(("apart", "is_same"), [(0.0, True), (1.9e-5, True), (-1.9e-5, True), (2.1e-5, False)])
def test_numbers_are_printed_to_two_hundred_thousandths(apart: float, is_same: bool) -> None:
    for number in (0.0, 0.25):
        assert is_printed([number + apart, 1.0], [number, 1.0]) == is_same
        assert is_printed([1.0, number + apart], [1.0, number]) == is_same


def test_an_era_is_one_sentence_with_both_heights() -> None:
    vision = next(script for script in all_scripts() if script.hole_tops_mm)
    assert [vision.era(top_mm) for top_mm in vision.hole_tops_mm] == [
        "before 2025-03-14: rim 19.9 mm in the books, 17.4 mm in the geometry",
        "since 2025-03-14: rim 17.4 mm in the books, 17.4 mm in the geometry",
    ]
    assert vision.era(None) is None


@pytest.mark.parametrize("top_mm", VISION.hole_tops_mm)
def test_every_start_of_the_vision_track_is_shown_from_its_own_hole(top_mm: float) -> None:
    starts = VISION.starts(top_mm)
    assert {start.listed_offset[-1] for start in starts} == {0.0, 1.0}
    for start in starts:
        x, y, theta, z, left = start.listed_offset
        beside = y - 22.625 if left else y + 22.625
        assert start.offset == pytest.approx((x, beside, theta, z + top_mm - 6.9))


def test_the_last_height_is_the_real_one_however_many_there_are_and_whichever_is_lower() -> None:
    script = VISION.model_copy(update={"hole_tops_mm": (19.9, 16.0, 17.4)})
    assert [(script.era(top_mm) or "").partition(" ")[0] for top_mm in script.hole_tops_mm] == [
        "before",
        "before",
        "since",
    ]
    assert script.era(16.0) == "before 2025-03-14: rim 16 mm in the books, 17.4 mm in the geometry"
    heights = [script.starts(top_mm)[0].true_offset[3] - VISION.offsets[0][3] for top_mm in script.hole_tops_mm]
    assert heights == pytest.approx([2.5, -1.4, 0.0])


def test_rules_of_the_peg_tasks_are_those_of_the_programs_of_2025() -> None:
    rules = {script.name: script.peg for script in all_scripts() if script.peg is not None}
    assert len(rules) >= 2
    assert {peg.surface_limit_m for peg in rules.values()} == {0.0015}
    assert rules[PEG.name].commanded_depth_mm == 0.35
    assert rules[VISION.name].commanded_depth_mm == 0.0, "with cameras the command does not count"
