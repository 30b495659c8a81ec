"""Twins of class B: drawn by choice, each difference does what it says, and can be switched off alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vitac.envs.assets import Meshes
from vitac.envs.fem.model.mesh import GelMesh
from vitac.envs.scene.gripper import SensorPose
from vitac.evaluator.strict_model import DocumentRejected
from vitac.station.description import TwinClass
from vitac.station.perception.markers import cut_picture, find_centres
from vitac.station.twin.bench import Backlash
from vitac.station.twin.gel_view import GelView
from vitac.station.twin.grasp import CUBOID_PEG, HeldPeg, hold_peg
from vitac.station.twin.hidden import HiddenSensor, HiddenSettings, TwinSecret, draw_hidden, make_twin, read_secret
from vitac.station.twin.structure import (
    Branch,
    Compliance,
    Difference,
    FaultyWrench,
    HiddenStructure,
    Print,
    Tilt,
    Weakening,
    WrenchError,
    twin_gel,
)

PERIOD_S = 0.1
BESIDE_MM = 4.0
ON_THE_PLATE_MM = -0.3


def hold(**structure: Any) -> HeldPeg:
    hidden = HiddenSettings(structure=HiddenStructure(**structure))
    meshes = Meshes(gel=twin_gel(hidden.structure), is_arena=True)
    return hold_peg(CUBOID_PEG, (BESIDE_MM, 0.0, 0.2, 0.0), hidden, meshes, PERIOD_S)


def press(held: HeldPeg) -> np.ndarray:
    held.follow((BESIDE_MM, 0.0, ON_THE_PLATE_MM, 0.0))
    return np.array(held.wrench())


def slide(held: HeldPeg, way_mm: float) -> float:
    """Slide by 1.2 mm, so far in each period, and return the lateral over the normal force."""
    press(held)
    for step in range(1, round(1.2 / way_mm) + 1):
        held.follow((BESIDE_MM - step * way_mm, 0.0, ON_THE_PLATE_MM, 0.0))
    force = np.array(held.wrench()[:3])
    return float(np.hypot(*force[:2]) / force[2])


def test_class_b_has_the_numbers_of_class_a_and_each_difference_is_switched_off_alone(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("{secret: hush, twin: B, without: [mesh, tilt]}")
    twin, whole = read_secret(secret), make_twin(TwinSecret(secret="hush", twin=TwinClass.B))  # noqa: S106 - drawn from, no password
    numbers = draw_hidden(b"hush")
    assert twin.hidden.model_copy(update={"structure": numbers.structure}) == numbers
    ours, full = twin.hidden.structure, whole.hidden.structure
    changed = [name for name in Difference if getattr(ours, name) != getattr(full, name)]
    assert changed == ["mesh", "tilt"]
    assert set(Difference) == set(HiddenStructure.model_fields)
    assert str(twin.mark) == "a twin of class B without mesh, tilt, no hardware"
    assert full.without(tuple(Difference)) == HiddenStructure()


def test_any_other_content_is_a_twin_of_class_a_and_a_wrong_word_is_named(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(range(256)))
    assert read_secret(secret).hidden == draw_hidden(bytes(range(256)))
    secret.write_text("{secret: hush, twin: B, without: [messh]}")
    with pytest.raises(DocumentRejected, match="mesh"):
        read_secret(secret)


def test_friction_weakens_with_speed() -> None:
    law = Weakening(kinetic_ratio=0.5, speed_mm_s=1.0)
    still, slow, fast = slide(hold(), 0.2), slide(hold(weakening=law), 0.05), slide(hold(weakening=law), 0.2)
    assert still == pytest.approx(0.3, rel=0.1)  # the plate's coefficient; the peg stands on the rim of its hole
    assert fast == pytest.approx(still * (0.5 + 0.5 / (1.0 + 2.0)), rel=0.05)
    assert fast < slow < 0.95 * still


def test_a_viscous_gel_relaxes_while_nothing_moves() -> None:
    held = hold(viscosity=(Branch(modulus_ratio=0.5, relaxation_time_s=0.3),))
    first = press(held)[2]
    while held.follow((BESIDE_MM, 0.0, ON_THE_PLATE_MM, 0.0)):
        pass
    assert 0.6 * first < held.wrench()[2] < 0.8 * first


@pytest.mark.parametrize(
    "structure",
    [
        {"compliance": Compliance(stage_n_mm=1e3, finger_n_mm=300.0, stick_mm=0.0)},
        {"tilt": Tilt(peg_deg=0.0, plate_deg=(0.0, 1.0))},
        {"yeoh": (1.0, 0.5)},
        {"mesh": True},
        {"unbonded_mm": 4.0},
    ],
)
def test_difference_changes_the_force_on_the_plate(structure: dict[str, Any]) -> None:
    plain, other = (press(held)[:3] for held in (hold(), hold(**structure)))
    assert np.linalg.norm(other - plain) > 0.01 * np.linalg.norm(plain)


def test_stage_gives_way_and_sticks() -> None:
    axis = Backlash(0.0, stick_mm=0.01, n_mm=100.0)
    assert [axis.follow(at) for at in (0.008, 0.012, 0.02)] == [0.0, 0.012, 0.012]
    for _ in range(40):
        at = axis.follow(0.02, 5.0)
    assert at == pytest.approx(0.012 + 0.05, abs=1e-4)


def test_force_sensor_lags_and_mixes() -> None:
    none = (0.0,) * 6
    crosstalk = ((0.0, 0.0, 0.1, 0.0, 0.0, 0.0), none, none, none, none, none)
    sensor = FaultyWrench(WrenchError(hysteresis_n=0.5, crosstalk=crosstalk))
    rising, falling = (sensor.show(np.array((0.0, 0.0, force, 0.0, 0.0, 0.0))) for force in (10.0, 8.0))
    assert rising[[0, 2]] == pytest.approx((0.95, 9.5))
    assert falling[2] == pytest.approx(8.5)


@pytest.fixture(scope="module")
def gel() -> GelMesh:
    return twin_gel(HiddenStructure())


def moving(gel: GelMesh, **structure: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the pictures of a gel before and during a shift along u."""
    sensor = HiddenSensor(noise=0.0, misprint_px=0.0)
    view = GelView(gel, sensor, HiddenStructure(**structure), PERIOD_S)
    still = view.picture()
    shifted = gel.rest_position_m + np.where(gel.driven[:, None], 0.0, np.array((-3e-4, 0.0, 0.0)))
    view.look(
        shifted, SensorPose(rotation=np.eye(3), centre_m=np.zeros(3)), np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    )
    return still, view.picture()


def rows_moved(pictures: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Return by how much markers of the upper and of the lower half have moved along u [pixel]."""
    before, after = (find_centres(cut_picture(picture)) for picture in pictures)
    nearest = np.linalg.norm(after[:, None] - before[None], axis=2).argmin(axis=1)
    moved, is_low = (after - before[nearest])[:, 0], after[:, 1] > 120.0
    return float(np.median(moved[~is_low])), float(np.median(moved[is_low]))


def test_rolling_shutter_shows_the_last_rows_later(gel: GelMesh) -> None:
    upper, lower = rows_moved(moving(gel))
    assert upper == pytest.approx(lower, abs=0.2)
    upper, lower = rows_moved(moving(gel, readout_s=PERIOD_S))
    assert abs(lower) > 2.0 * abs(upper)


def test_exposure_smears_moving_markers_only(gel: GelMesh) -> None:
    (still, sharp), (also_still, smeared) = moving(gel), moving(gel, exposure_s=PERIOD_S)
    assert np.array_equal(still, also_still)
    assert smeared.std() < 0.995 * sharp.std()


def test_light_fades_by_colour_and_print_moves_markers(gel: GelMesh) -> None:
    sensor = HiddenSensor(noise=0.0, misprint_px=0.0)
    view = GelView(gel, sensor, HiddenStructure(fading_h=(0.0, 0.1, 0.5)), PERIOD_S)
    new, old = (view.picture(age_h=age).mean(axis=(0, 1)) for age in (0.0, 1.0))
    assert old / new == pytest.approx(np.exp((0.0, -0.1, -0.5)), abs=0.01)
    off = Print(shift_px=(3.0, 0.0), turn_deg=0.0, stretch=0.0, scatter_px=0.0)
    on_grid, moved = (
        find_centres(cut_picture(GelView(gel, sensor, HiddenStructure(print=each), PERIOD_S).picture()))
        for each in (None, off)
    )
    assert moved.mean(axis=0) - on_grid.mean(axis=0) == pytest.approx((3.0, 0.0), abs=0.3)
