"""The world of a twin, advanced by hand: what its devices are told moves gels, peg and markers."""

import struct
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from vitac.envs.geometry.pegs import PLATE_THICKNESS_MM
from vitac.envs.tactile.gel import arena_gel_mesh
from vitac.station.description import StationTask
from vitac.station.perception.markers import DROPPED_PICTURES, AssignedMarkerTracker, cut_picture, find_centres
from vitac.station.perception.observation import DAMAGED_PART, find_changed_part, measure_brightness
from vitac.station.twin.bench import GRIP_FORCE, PEG_AT, Backlash, Bench
from vitac.station.twin.force_torque import ForceTorqueFault
from vitac.station.twin.grasp import CUBOID_PEG, HOLE, Mounted
from vitac.station.twin.gripper import GripperFault, checksum
from vitac.station.twin.hidden import (
    PUBLIC_SETTINGS,
    FaultScript,
    HiddenSettings,
    ScriptedFault,
    TwinFault,
    draw_hidden,
)
from vitac.station.twin.pictures import CameraFault
from vitac.station.twin.stage import StageFault


@pytest.fixture
def bench() -> Bench:
    return Bench(hidden=PUBLIC_SETTINGS, period_s=0.1)


def grip(bench: Bench, position: int) -> None:
    registers = (0x0900, position, 0xFF00 | GRIP_FORCE)
    request = struct.pack(">BBHHB3H", 9, 0x10, 0x03E8, 3, 6, *registers)
    bench.gripper.receive(request + checksum(request))


def go(bench: Bench, *axes: float, speed_mm_s: float = 50.0) -> None:
    words = " ".join(f"{name}{value}" for name, value in zip("XYZA", axes, strict=True))
    bench.stage.receive(f"G90 G1 {words} F{60 * speed_mm_s}\n".encode())
    while bench.stage.axes() != axes:
        bench.advance()
    bench.advance()


def fetch(bench: Bench) -> None:
    go(bench, *CUBOID_PEG.garage)
    grip(bench, 255)
    for _ in range(6):
        bench.advance()


def centres(bench: Bench) -> list[np.ndarray]:
    pictures = [view.picture() for view in bench.views]
    return [find_centres(cut_picture(picture)) for picture in pictures]


def test_gripper_closes_on_the_peg_in_its_garage_and_both_gels_show_it(bench: Bench) -> None:
    before = centres(bench)
    fetch(bench)
    assert bench.held is not None
    grasped = bench.held.scene
    assert (grasped.gel.name, grasped.physics.poisson_ratio) == (arena_gel_mesh().name, 0.48)
    assert round(bench.gripper.position()) == PEG_AT
    for still, pressed in zip(before, centres(bench), strict=True):
        assert len(pressed) >= 0.9 * len(still)
        nearest = np.linalg.norm(pressed[:, None] - still[None], axis=2).min(axis=1)
        assert np.median(nearest) > 1.0


def test_edges_of_a_tapered_handle_are_not_taken_for_markers() -> None:
    """The gel moves by 10 pixels. The edges are dark in one light; as markers they stopped the station at 30."""
    key = Mounted(StationTask.LOCK, "key4")
    bench, trackers = Bench(hidden=PUBLIC_SETTINGS, mounted=key, period_s=0.1), [AssignedMarkerTracker() for _ in "lr"]
    x_mm, y_mm, z_mm, rotation_deg = key.garage
    go(bench, x_mm + 0.5, y_mm, z_mm - 0.5, rotation_deg)
    for picture in range(DROPPED_PICTURES + 12):
        if picture == DROPPED_PICTURES + 1:
            grip(bench, 255)
        flows = [tracker.see(view.picture()) for tracker, view in zip(trackers, bench.views, strict=True)]
        bench.advance()
    assert bench.held is not None
    for flow in flows:
        assert flow is not None
        assert len(flow.current) >= 62
        assert 8.0 < flow.largest_movement_px() < 11.0


def test_gripper_closes_on_nothing_elsewhere(bench: Bench) -> None:
    go(bench, -20.0, 0.0, -30.0, 0.0)
    grip(bench, 255)
    for _ in range(6):
        bench.advance()
    assert bench.held is None
    assert round(bench.gripper.position()) == 255


def test_plate_is_felt_beside_the_hole_and_not_over_it_and_a_script_breaks_what_it_names_then() -> None:
    spike = ScriptedFault(fault=TwinFault.FORCE_SPIKE, contact=1, for_s=0.3)
    bench = Bench(hidden=PUBLIC_SETTINGS, period_s=0.1, script=FaultScript(faults=(spike,)))
    fetch(bench)
    go(bench, *CUBOID_PEG.garage[:2], -20.0, 0.0)
    go(bench, 4.0, -2.0, -20.0, 5.0)
    assert abs(bench.box.wrench()[2]) < 1.0
    in_air = [measure_brightness(view.picture()) for view in bench.views]
    go(bench, 4.0, -2.0, HOLE[2] - 0.3, 5.0)
    assert bench.box.wrench()[2] == 500.0
    for _ in range(4):
        bench.advance()
    force_x, force_y, force_z, torque_x, torque_y, _ = bench.box.wrench()
    assert 2.0 < force_z < 60.0
    # Beside the hole the peg stands on a part of its lower end, and the gripper, beside its middle, holds it upright.
    assert 0.02 < np.hypot(torque_x, torque_y) < 0.03 * force_z + 0.2 * np.hypot(force_x, force_y)
    still = measure_brightness(bench.views[0].picture())
    assert find_changed_part(in_air[0], still) == 0.0
    assert find_changed_part(still, measure_brightness(bench.views[0].picture(is_torn=True))) > 1.5 * DAMAGED_PART
    go(bench, 4.0, -2.0, HOLE[2] + 5.0, 5.0)
    go(bench, *HOLE)
    go(bench, *HOLE[:2], HOLE[2] - 1.0, 0.0)
    assert abs(bench.box.wrench()[2]) < 1.0
    assert bench.contacts == 1
    assert bench.held is not None
    corners_m = bench.held.scene.held_vertices_m(np.arange(len(bench.held.scene.held_surface.vertices_m)))
    assert PLATE_THICKNESS_MM - 1e3 * corners_m[:, 2].min() == pytest.approx(1.0, abs=0.2)


def test_camera_sends_no_picture_twice_however_long_the_physics_takes(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vitac.station.twin.bench._READER_S", 0.01)
    bench.cameras[0].streams = 1
    bench.advance()
    first = bench.take(0)
    with ThreadPoolExecutor(1) as pool:
        second = pool.submit(bench.take, 0)
        with pytest.raises(TimeoutError):
            second.result(0.3)
        bench.advance()
        assert not np.array_equal(second.result(), first)


def test_part_is_seen_where_it_is(bench: Bench) -> None:
    assert bench.part_at() == CUBOID_PEG.garage
    fetch(bench)
    go(bench, 0.0, 0.0, -20.0, 0.0)
    assert bench.part_at() == (0.0, 0.0, -20.0, 0.0)
    bench.begin(TwinFault.DROPPED_PEG, 0.1)
    assert bench.part_at() is None


def test_stuck_gripper_holds_on_to_its_peg(bench: Bench) -> None:
    fetch(bench)
    bench.begin(TwinFault.STUCK_GRIPPER, 1.0)
    for _ in range(12):
        bench.advance()
        assert bench.held is not None
        assert round(bench.gripper.position()) == PEG_AT


def test_dropped_peg_leaves_the_gels_at_rest_until_a_person_puts_it_back(bench: Bench) -> None:
    before = centres(bench)
    fetch(bench)
    bench.begin(TwinFault.DROPPED_PEG, 1.0)
    for _ in range(5):
        bench.advance()
    assert bench.held is None
    assert round(bench.gripper.position()) == 255
    assert [len(each) for each in centres(bench)] == [len(each) for each in before]
    grip(bench, 0)
    for _ in range(10):
        bench.advance()
    fetch(bench)
    assert bench.held is not None


def test_torn_gel_has_lost_markers(bench: Bench) -> None:
    (left, _), torn = centres(bench), bench.views[0].picture(is_torn=True)
    assert len(find_centres(cut_picture(torn))) < 0.9 * len(left)


@pytest.mark.parametrize(
    ("fault", "device", "expected"),
    [
        (TwinFault.UNPLUGGED_CAMERA, "cameras", CameraFault.UNPLUGGED),
        (TwinFault.FROZEN_STREAM, "cameras", CameraFault.FROZEN),
        (TwinFault.STUCK_GRIPPER, "gripper", GripperFault.STUCK),
        (TwinFault.STAGE_ALARM, "stage", StageFault.ALARM),
        (TwinFault.NETWORK_CUT, "box", ForceTorqueFault.UNREACHABLE),
    ],
)
def test_fault_of_a_device_begins_and_ends(bench: Bench, fault: TwinFault, device: str, expected: object) -> None:
    broken = getattr(bench, device)[0] if device == "cameras" else getattr(bench, device)
    bench.begin(fault, 1.0)
    assert broken.faults == {expected}
    for _ in range(11):
        bench.advance()
    assert broken.faults == set()


def test_axis_follows_with_play_and_loses_steps_until_it_is_homed() -> None:
    axis = Backlash(play_mm=0.2, lost=0.01)
    assert axis.follow(10.0) == pytest.approx(9.9 - 0.1)
    assert axis.follow(9.9) == pytest.approx(9.9 - 0.099)
    assert axis.follow(0.0) == pytest.approx(0.1)
    axis.follow(10.0)
    axis.find_steps()
    assert axis.follow(10.0) == pytest.approx(9.9)


def test_twin_is_drawn_from_its_secret_and_differs_from_the_public_one() -> None:
    assert draw_hidden(b"secret") == draw_hidden(b"secret")
    drawn = draw_hidden(b"secret")
    differing = [name for name in HiddenSettings.model_fields if getattr(drawn, name) != getattr(PUBLIC_SETTINGS, name)]
    assert set(differing) == set(HiddenSettings.model_fields) - {"structure"}
