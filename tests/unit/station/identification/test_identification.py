"""What probes show of a station: cameras and viscosity by themselves, the rest by our simulation of them."""

from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.assets import Meshes
from vitac.envs.tactile.gel import arena_gel_mesh
from vitac.envs.tasks.quantities import CAMERA_MOUNT_QUANTITIES
from vitac.station.devices.stage import Pose
from vitac.station.identification import probes
from vitac.station.identification.camera import TooFewMarkers, fit_camera, stretched_print, undo_lens
from vitac.station.identification.mechanics import _NUMBERS, Estimate, _improve, _Replay
from vitac.station.identification.probes import ProbeKind, Probing, Sample
from vitac.station.identification.station import _draws, _fit_viscosity
from vitac.station.perception.markers import MarkerFlow, cut_picture, find_centres
from vitac.station.twin.gel_view import GelView, marker_grid, see_through_lens
from vitac.station.twin.grasp import Mounted, hold_peg, in_world
from vitac.station.twin.hidden import HiddenSensor, HiddenSettings
from vitac.station.twin.structure import HiddenStructure, Tilt

NO_MARKERS = MarkerFlow(np.zeros((0, 2)), np.zeros((0, 2)))


def sample(probe: ProbeKind, axes: tuple[float, float, float], force_n: float, after_s: float = 0.0) -> Sample:
    wrench = np.array((0.0, 0.0, force_n, 0.0, 0.0, 0.0))
    return Sample(probe, Pose(*axes, 0.0), wrench, (NO_MARKERS, NO_MARKERS), after_s)


def probing(*samples: Sample) -> Probing:
    return Probing(rest_px=(marker_grid(), marker_grid()), samples=list(samples))


@pytest.mark.parametrize(("seed", "stretch"), [(3, 0.0), (4, 0.01)])
def test_camera_and_stretched_print_are_found_from_a_picture_of_a_free_gel_within_a_pixel(
    seed: int, stretch: float
) -> None:
    u, v, turn, lens = np.random.default_rng(seed).uniform(-1.0, 1.0, 4).tolist()
    sensor = HiddenSensor(shift_px=(4 * u, 4 * v), turn_deg=1.5 * turn, distortion=0.03 * lens, worn=3, seed=seed)
    view = GelView(arena_gel_mesh(), sensor, HiddenStructure(print=stretched_print(stretch)))
    fitted = fit_camera(find_centres(cut_picture(view.picture())))
    places = np.random.default_rng(seed).uniform((10, 10), (310, 230), (50, 2))
    errors_px = np.linalg.norm(see_through_lens(fitted.sensor, places) - see_through_lens(sensor, places), axis=1)
    assert errors_px.max() < 1.0
    true = dict(zip(fitted.values, (*sensor.shift_px, sensor.turn_deg, sensor.distortion, stretch), strict=True))
    assert all(abs(fitted.values[name] - true[name]) < 4.0 * fitted.deviations[name] for name in true)
    assert undo_lens(sensor, see_through_lens(sensor, places)) == pytest.approx(places, abs=1e-6)


def test_a_gel_without_markers_says_what_to_do() -> None:
    with pytest.raises(TooFewMarkers, match="got 4"):
        fit_camera(marker_grid()[:4])


@pytest.mark.parametrize(("ratio", "is_seen"), [(0.15, True), (0.0, False)])
def test_viscosity_is_seen_where_a_held_press_relaxes(ratio: float, is_seen: bool) -> None:
    random = np.random.default_rng(1)
    times_s = 0.6 * np.arange(12)
    forces_n = 8.0 * (1.0 + ratio * np.exp(-times_s / 1.5)) + 0.005 * random.normal(size=12)
    held = [sample(ProbeKind.HOLD, (0.0, 0.0, 0.0), *each) for each in zip(forces_n, times_s, strict=True)]
    branch, estimates = _fit_viscosity(probing(*held))
    assert (branch is not None) == is_seen
    assert estimates["viscous_ratio"].value == pytest.approx(ratio, abs=0.01)
    if branch:
        assert branch.relaxation_time_s == pytest.approx(1.5, rel=0.3)


class Mechanics:
    """Differences as a fit sees them: of two numbers one bends, and the third shows in nothing."""

    noise = np.full(40, 0.1)

    def __init__(self, hidden: tuple[float, float]) -> None:
        self.observed = self.predict(np.array((*hidden, 0.0, *np.zeros(len(_NUMBERS) - 3))))

    def predict(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        along = np.linspace(0.0, 1.0, 40)
        # Below its threshold the first number has no effect, as friction has none before something slips.
        return np.asarray(np.minimum(3.0 * along, np.exp(0.5 * z[0])) + z[1] * along**2)


@pytest.mark.parametrize("hidden", [(1.5, -1.0), (-2.0, 2.0)])
def test_a_fit_comes_to_hidden_numbers_from_afar_and_leaves_what_is_not_seen(hidden: tuple[float, float]) -> None:
    fit = _improve(cast("Any", Mechanics(hidden)), np.zeros(len(_NUMBERS)))
    assert fit.z[:2] == pytest.approx(hidden, abs=0.1)
    deviations = np.sqrt(np.diag(np.linalg.inv(fit.normal_equations()[0])))
    assert (deviations[:2] < 0.2).all()
    assert fit.z[2] == pytest.approx(0.0)
    assert deviations[2] == pytest.approx(1.0)


class CurvedValley:
    """Differences along whose least a straight step leads out: two tries in a row that gain nothing are no end."""

    observed, noise = np.zeros(2), np.ones(2)

    def predict(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = z[0] - 1.2, z[1] + 1.0
        return np.array((50.0 * (y - x**2), 5.0 * (1.0 - x)))


def test_a_fit_follows_a_curved_valley() -> None:
    fit = _improve(cast("Any", CurvedValley()), np.zeros(len(_NUMBERS)))
    assert fit.z[:2] == pytest.approx((2.2, 0.0), abs=0.2)


def light_press(gel_friction: float) -> NDArray[np.float64]:
    """Return what our simulation shows of a press of a peg that is held lightly, at one friction of the gels."""
    poses = [(ProbeKind.LIGHT_GRASP, 0.7), (ProbeKind.AIR, 0.7), *((ProbeKind.LIGHT, -z) for z in (0.3, 0.8, 1.3, 1.8))]
    still = MarkerFlow(marker_grid(), marker_grid())
    samples = [Sample(kind, Pose(4.5, 0.0, z_mm, 0.0), np.zeros(6), (still, still)) for kind, z_mm in poses]
    cameras = HiddenSensor(), HiddenSensor()
    replay = _Replay(probing(*samples), cameras, Mounted(), (0.0, 0.0, 0.0, 0.0), 0.0, tuple(ProbeKind))
    number = next(each for each in _NUMBERS if each.name == "gel_friction")
    z = np.array([np.log(gel_friction) / number.spread if each is number else 0.0 for each in _NUMBERS])
    return np.asarray((replay.predict(z) / replay.noise).reshape(len(samples), -1))


def test_a_peg_that_is_held_lightly_slips_and_so_shows_the_friction_of_the_gels() -> None:
    difference = np.abs(light_press(1.2) - light_press(0.8))
    assert difference[-1, 2] > 10.0  # of the force along z, in deviations of noise
    assert difference[0].max() < 1.0


def test_environments_get_the_intervals_of_what_was_seen_alone() -> None:
    names = ("youngs_modulus_pa", "poisson_ratio", "viscous_ratio", "indentation_mm", "gel_friction", "plate_friction",
             "grasp_x_mm", "grasp_z_mm", "tolerance_mm", "peg_tilt_deg", "plate_tilt_x_deg", "plate_tilt_y_deg",
             *(quantity.name for quantity in CAMERA_MOUNT_QUANTITIES))  # fmt: skip
    estimates = {name: Estimate(0.4, 0.3, 0.5, name != "gel_friction") for name in names}
    estimates["youngs_modulus_pa"] = Estimate(2e5, 1.9e5, 2.1e5, True)
    draws = _draws(estimates)
    assert draws["gel_modulus_kpa"] == pytest.approx((190.0, 210.0))
    assert draws["gel_poisson_ratio"] == pytest.approx((0.3, 0.49))  # as far as environments can have it
    assert draws["gripper_z_mm"] == pytest.approx((-7.7, -7.5))
    assert draws["clearance_mm"] == pytest.approx((1.8, 2.0))
    assert draws["hole_tilt_x_deg"] == pytest.approx((0.3, 0.5))
    assert draws["left_turn_deg"] == pytest.approx((0.3, 0.5))
    assert "gel_friction" not in draws


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_probe_meets_what_it_looks_for_at_a_station_that_is_as_far_off_as_twins_are(sign: float) -> None:
    tilt = Tilt(peg_deg=1.5 * sign, plate_deg=(1.5, -1.5 * sign))
    hidden = HiddenSettings(
        youngs_modulus_pa=2.4e5,
        poisson_ratio=0.45,
        indentation_mm=0.7,
        grasp_z_mm=0.3 * sign,
        plate_mm=0.2 * sign,
        origin=(0.2, 0.2, 0.3),
        structure=HiddenStructure(tilt=tilt, tolerance_mm=0.1),
    )
    hole, meshes = (0.0, 0.0, 0.0, 0.0), Meshes(gel=arena_gel_mesh(), is_arena=True)

    def touch(x_mm: float, y_mm: float, z_mm: float, *, then: tuple[float, float, float]) -> float:
        """Return the force in newtons by which a pose differs from one in free air."""
        held = hold_peg(Mounted(), in_world((x_mm, y_mm, probes._ABOVE_MM, 0.0), hole, hidden), hidden, meshes)
        free_n = np.array(held.wrench()[:3])
        for x, y, z in ((x_mm, y_mm, z_mm), then):
            held.follow(in_world((x, y, z, 0.0), hole, hidden), way_mm=0.1)
        return float(np.linalg.norm(np.array(held.wrench()[:3]) - free_n))

    beside_mm, in_hole_mm, far_mm = probes._BESIDE_MM, -probes._IN_HOLE_MM, probes._TOWARDS_WALL_MM
    for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        there = x * beside_mm, y * beside_mm
        assert touch(*there, probes._ABOVE_MM, then=(*there, probes._ABOVE_MM)) < 0.1
        assert touch(*there, 0.0, then=(*there, -probes._BELOW_MM)) > probes._TOUCH_N
    assert touch(0.0, 0.0, in_hole_mm, then=(0.0, 0.0, in_hole_mm)) < 0.1
    for x in (1, -1):
        assert touch(0.0, 0.0, in_hole_mm, then=(x * far_mm, 0.0, in_hole_mm)) > probes._WALL_N
