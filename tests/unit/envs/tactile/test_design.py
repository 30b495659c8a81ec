from contextlib import nullcontext
from dataclasses import replace

import drawn_gels
import numpy as np
import own_sensors
import pytest
from vitac.envs.sensor_design.mesher import MeshGoal, mesh_height_field
from vitac.envs.sensor_design.surface import placed_on_base
from vitac.envs.sensor_design.tetrahedra import make_gel
from vitac.envs.tactile.camera import camera_frame, project
from vitac.envs.tactile.design import TOUCHED_M, Fault, NothingReached, SensorDesign, attach_along_rays
from vitac.envs.tactile.gel import eye_distance_m, highest_mm
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tactile.sensor import DesignedSensor, MarkersNotAttached

QUIET = MarkerSettings(noise_px=0.0, loss_probability=0.0)


def at_rest(sensor: SensorDesign, settings: MarkerSettings = QUIET) -> tuple[DesignedSensor, np.ndarray]:
    tactile = DesignedSensor(sensor, settings)
    view = tactile.view_m(sensor.gel.rest_position_m, np.eye(3), np.zeros(3))
    tactile.capture_reference(view)
    return tactile, view


@pytest.mark.parametrize("name", own_sensors.GELS)
def test_markers_lie_in_their_triangles_on_the_cameras_ray(name: str) -> None:
    sensor = own_sensors.designed(name)
    found = sensor.attachment
    assert (found.faults == Fault.NONE).all()
    assert (found.weights >= 0.0).all()
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0)
    seen = camera_frame(sensor.printed_m, np.eye(3), np.zeros(3), eye_distance_m(sensor.gel))
    np.testing.assert_allclose(project(seen, sensor.camera), sensor.rest_pixels, atol=1e-6)
    sensing = {tuple(sorted(row)) for row in sensor.sensing_triangles.tolist()}
    carrying = sensor.gel.surface_triangles[found.triangles].tolist()
    assert {tuple(sorted(row)) for row in carrying} <= sensing


def test_markers_of_a_flat_gel_are_where_they_are_drawn() -> None:
    sensor = own_sensors.designed("4 mm")
    np.testing.assert_allclose(sensor.printed_m[:, :2] * 1e3, sensor.markers_mm, atol=1e-9)
    np.testing.assert_allclose(sensor.printed_m[:, 2], 2e-3, atol=1e-12)


def test_ray_takes_the_first_face_that_it_leaves_by() -> None:
    """Beside the ridge the ray meets the floor; a marker drawn over the ridge is on top of it."""
    sensor = own_sensors.design(drawn_gels.ridge(), "{points_mm: [[0, 0], [0.9, 6.9], [3, 0]]}")
    np.testing.assert_allclose(sensor.printed_m[:, 2] * 1e3, [2.0, 2.0, 0.5], atol=1e-6)


def test_what_the_grasp_reaches_has_shares_of_its_area() -> None:
    """Of the ridge its top, of the flat gel all of its face, of the pyramids what is 0.875 mm below the tips."""
    for name, area_mm2 in (("ridge", 2.0 * 14.0), ("4 mm", 25.25 * 20.75)):
        sensor = own_sensors.designed(name)
        touched = sensor.touched
        assert touched.areas_m2.sum() == pytest.approx(1.0)
        heights_m = sensor.gel.rest_position_m[sensor.gel.sensing_nodes[touched.corners], 2]
        np.testing.assert_allclose(heights_m, 2e-3)
        n_places = 16 * len(sensor.sensing_triangles)
        assert len(touched.areas_m2) == n_places if name == "4 mm" else len(touched.areas_m2) < n_places
        corners_m = sensor.gel.rest_position_m[sensor.gel.sensing_nodes[touched.corners[::16]]]
        areas_m2 = 0.5 * np.linalg.norm(
            np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]), axis=1
        )
        assert areas_m2.sum() * 1e6 == pytest.approx(area_mm2)
    sensor = own_sensors.designed("pyramids")
    corners, weights, _ = sensor.touched
    z_m = (sensor.gel.rest_position_m[sensor.gel.sensing_nodes[corners], 2] * weights).sum(axis=1)
    top_m = sensor.gel.rest_position_m[:, 2].max()
    assert top_m - 0.875e-3 <= z_m.min() < top_m - 0.8e-3


def test_needles_that_lean_too_much_to_sense_leave_nothing_to_measure() -> None:
    """The floor between them senses, but the grasp does not reach it."""
    sensor = own_sensors.designed("pyramids")
    floor = sensor.gel.rest_position_m[sensor.sensing_triangles, 2].max(axis=1) < 0.3e-3
    needles = replace(sensor, sensing_triangles=sensor.sensing_triangles[floor])
    assert needles.sensing_depth_m == pytest.approx(2e-3)
    with pytest.raises(NothingReached, match=r"at most 0\.875 mm below .*, got the highest one 2\.000 mm below"):
        _ = needles.touched


def test_a_face_is_reached_where_a_place_on_it_is_not_only_a_corner() -> None:
    sensor = own_sensors.designed("pyramids")
    reached = []
    for face in sensor.sensing_triangles:
        alone = replace(sensor, sensing_triangles=face[None])
        top_m, z_m = sensor.gel.rest_position_m[:, 2].max(), sensor.gel.rest_position_m[face, 2]
        assert top_m - z_m.max() <= alone.sensing_depth_m + 1e-12 <= top_m - z_m.min() + 2e-12
        reached.append(alone.sensing_depth_m <= TOUCHED_M)
        with nullcontext() if reached[-1] else pytest.raises(NothingReached):
            assert alone.touched.areas_m2.sum() == pytest.approx(1.0)
    assert set(reached) == {True, False}


def refined(min_nodes: int) -> SensorDesign:
    drawn = placed_on_base(drawn_gels.dome(), length_mm=25.25, width_mm=20.75)
    goal = MeshGoal(
        length_mm=25.25,
        width_mm=20.75,
        min_nodes=min_nodes,
        max_nodes=2000,
        max_distance_mm=0.1,
        max_volume_error=0.01,
        min_quality=0.01,
        tip_depth_mm=0.875,
        min_tip_nodes=25,
    )
    gel, sensing = make_gel(mesh_height_field(drawn, goal), name="dome")
    return replace(own_sensors.designed("dome"), gel=gel, sensing_triangles=sensing)


def test_surface_difference_does_not_depend_on_the_mesh() -> None:
    """A bulge that falls off from the middle: the area mean agrees between meshes, and does not see node numbers."""

    def difference(sensor: SensorDesign) -> float:
        tactile, _ = at_rest(sensor)
        moved = sensor.gel.rest_position_m.copy()
        moved[:, 0] += 1e-3 * np.maximum(0.0, 1.0 - (moved[:, :2] ** 2).sum(axis=1) / 0.01**2)
        return tactile.surface_diff_m(tactile.view_m(moved, np.eye(3), np.zeros(3)))

    coarse, fine = refined(250), refined(700)
    assert len(fine.gel.rest_position_m) > 2 * len(coarse.gel.rest_position_m)
    assert difference(coarse) == pytest.approx(difference(fine), rel=0.03)


def test_flow_follows_the_surface_and_repeats_the_last_marker() -> None:
    sensor = own_sensors.designed("4 mm")
    tactile, view = at_rest(sensor)
    flow = tactile.marker_flow(view + np.array([1e-3, 0.0, 0.0]), np.random.default_rng(1))
    assert flow.shape == (2, 128, 2)
    np.testing.assert_allclose(flow[0, :48], sensor.rest_pixels, atol=1e-9)
    np.testing.assert_array_equal(flow[:, 48:], np.repeat(flow[:, 47:48], 80, axis=1))
    np.testing.assert_allclose(flow[1] - flow[0], np.tile([340.0 / 22.0, 0.0], (128, 1)), atol=1e-9)


def test_camera_of_the_design_is_used() -> None:
    sensor = own_sensors.design(drawn_gels.flat(), "{points_mm: [[1, 0]]}", "{focal_px: [200, 100]}")
    tactile, view = at_rest(sensor)
    assert tactile.marker_flow(view, np.random.default_rng(1))[0, 0] == pytest.approx([160 - 200 / 22, 125])


def test_markers_are_lost_with_the_organizers_probability_but_never_all() -> None:
    always = MarkerSettings(noise_px=0.0, loss_probability=1.0)
    tactile, view = at_rest(own_sensors.designed("4 mm"), always)
    flow = tactile.marker_flow(view, np.random.default_rng(1))
    np.testing.assert_allclose(flow[0], np.tile(own_sensors.designed("4 mm").rest_pixels[0], (128, 1)), atol=1e-9)
    half = MarkerSettings(noise_px=0.0, loss_probability=0.5)
    tactile, view = at_rest(own_sensors.designed("4 mm"), half)
    seen = np.unique(tactile.marker_flow(view, np.random.default_rng(1))[0], axis=0)
    assert 12 < len(seen) < 36


def test_design_whose_markers_are_off_its_faces_is_refused() -> None:
    broken = replace(own_sensors.designed("4 mm"), markers_mm=np.array([[0.0, 0.0], [40.0, 0.0]]))
    assert broken.attachment.faults.tolist() == [Fault.NONE, Fault.OFF_THE_GEL]
    np.testing.assert_allclose(broken.printed_m, [[0.0, 0.0, 2e-3]], atol=1e-12)
    with pytest.raises(MarkersNotAttached, match="1 of 2 markers"):
        DesignedSensor(broken, MarkerSettings())


def test_face_seen_edge_on_carries_no_marker() -> None:
    """From the eye a tall roof is a wall: its faces lean from the ray by less than 3 degrees."""
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 60.0]])
    triangles = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    senses = np.array([False, False, True, True, True, True])
    found = attach_along_rays((0.0, 0.0, -100.0), np.array([[0.5, 0.1, 0.0], [5.0, 0, 0]]), corners, triangles, senses)
    assert found.faults.tolist() == [Fault.EDGE_ON, Fault.OFF_THE_GEL]
    assert found.triangles.tolist() == [3, -1]


@pytest.mark.parametrize(("name", "height_mm"), [("2 mm", 1.0), ("4 mm", 2.0), ("8 mm", 4.0), ("ridge", 2.0)])
def test_camera_stands_18_mm_behind_every_gel(name: str, height_mm: float) -> None:
    gel = own_sensors.designed(name).gel
    assert highest_mm(gel) == pytest.approx(height_mm, abs=1e-5)
    assert eye_distance_m(gel) == pytest.approx(0.018 + 1e-3 * height_mm, abs=1e-8)


def test_hash_covers_camera_markers_and_sensing_faces() -> None:
    sensor = own_sensors.designed("4 mm")
    changed = [
        sensor,
        replace(sensor, camera=sensor.camera._replace(focal_u_px=341.0)),
        replace(sensor, markers_mm=sensor.markers_mm + 1e-6),
        replace(sensor, sensing_triangles=sensor.sensing_triangles[:-1]),
    ]
    assert len({variant.as_bytes() for variant in changed}) == 4
