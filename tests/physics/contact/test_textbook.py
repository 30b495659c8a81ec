"""Small versions of `benchmarks/contact/textbook.py`: materials and shapes that no task has."""

import numpy as np
import pytest
from contact.domes import Dome, partial_slip, press_dome
from contact.elastic import Rubber, sheared_grip, slide_pad
from contact.faces import change_of_velocity, press_corner, work_of_cycle_j
from contact.jamming import PegInHole
from contact.rigid import Block, incline_acceleration_error, incline_drift_m, is_wedged, largest_rise_of_energy
from contact.viscosity import VISCOUS

BRASS = Block(corners=6, radius_m=0.02, height_m=0.006, density_kg_m3=7800.0, material="brass")
NYLON = Block(corners=3, radius_m=0.03, height_m=0.02, density_kg_m3=1200.0, material="nylon")
SOFT = Rubber(youngs_modulus_pa=8e4, poisson_ratio=0.42)


@pytest.mark.parametrize("time_step_s", [0.5, 0.05])
def test_block_drifts_less_than_ten_micrometres_in_a_minute(time_step_s: float) -> None:
    assert incline_drift_m(NYLON, 0.8, 0.9, 60.0, time_step_s) < 1e-5


def test_block_slides_with_coulombs_acceleration() -> None:
    assert abs(incline_acceleration_error(BRASS, 0.15, 0.25, 0.01)) < 0.01


def test_rod_wedges_where_both_friction_cones_hold_the_line_between_its_touches() -> None:
    assert [is_wedged(friction, 0.5) for friction in (0.475, 0.525)] == [False, True]


@pytest.mark.parametrize(("moment", "side"), [(0.0, 1.0), (1.3, -0.5), (1.3, 1.0)])
def test_peg_jams_outside_of_whitneys_parallelogram(moment: float, side: float) -> None:
    peg = PegInHole(friction=0.3)
    load = peg.foretold_load(moment, side)
    assert [peg.jams(part * load * moment, part * load * side) for part in (0.97, 1.03)] == [False, True]


def test_dome_that_is_dragged_sticks_within_mindlins_radius() -> None:
    rubber = Rubber(youngs_modulus_pa=3e4)
    pressed = press_dome(Dome(radius_m=0.6, cells=4, outer_cells=5), rubber)
    assert pressed.force_n == pytest.approx(pressed.hertz_force_n, rel=0.2)
    measured, foretold = partial_slip(pressed, rubber, friction=0.5, part=0.6)
    assert measured == pytest.approx(foretold, rel=0.05)


def test_energy_only_falls() -> None:
    assert largest_rise_of_energy(BRASS, 0.15, 0.01) < 1e-4


def test_pad_holds_for_a_minute_and_slides_at_the_limit() -> None:
    slid = slide_pad((0.02, 0.015, 0.004), SOFT, 0.7, time_step_s=2.0)
    assert slid.full == pytest.approx(1.0, abs=0.01)
    assert slid.peak == pytest.approx(1.0, abs=0.01)
    assert slid.relaxed < 1e-3


def test_grip_is_balanced_symmetric_and_independent_of_the_step() -> None:
    whole, halved = (sheared_grip(SOFT, 0.6, cells=(3, 3, 2), halved_step=halved) for halved in (False, True))
    assert whole.unbalanced < 0.01
    assert whole.asymmetry < 0.01
    np.testing.assert_allclose(halved.force_n, whole.force_n, atol=0.03 * float(np.linalg.norm(whole.force_n)))


def test_a_corner_on_a_flat_face_is_pressed_straight_away_from_it_however_it_is_triangulated() -> None:
    rng = np.random.default_rng(11)
    pressed = [press_corner(rng, force_n) for force_n in (0.3, 1.5, 6.0, 20.0) for _ in range(5)]
    assert max(each.lateral for each in pressed) < 1e-9
    assert max(abs(each.excess) for each in pressed) < 1e-9


def test_a_block_thrown_over_the_edges_of_a_flat_face_keeps_its_velocity() -> None:
    assert change_of_velocity(np.random.default_rng(5), 0.01) < 1e-5


@pytest.mark.parametrize("seed", [1, 2])
def test_no_closed_cycle_of_shear_and_pressure_yields_energy(seed: int) -> None:
    work_j, stored_j = work_of_cycle_j(np.random.default_rng(seed), 0.6)
    assert stored_j > 0.0
    assert work_j < 1e-6 * stored_j


@pytest.mark.parametrize("what", VISCOUS)
def test_viscous_gel_relaxes_creeps_and_costs_energy_as_the_standard_linear_solid(what: str) -> None:
    assert VISCOUS[what](np.random.default_rng(11), 0.47) == pytest.approx(1.0, abs=0.01)
