import os
from pathlib import Path

import numpy as np
import pytest
from vitac.evaluator.sensors.manifest import SensorManifest, SensorRejected, read_sensor


def read(text: str | bytes, folder: Path) -> SensorManifest:
    (folder / "sensor.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_sensor(folder)


def test_camera_and_markers_are_the_challenges_by_default(tmp_path: Path) -> None:
    sensor = read("{}", tmp_path)
    camera = sensor.camera.intrinsics()
    assert (camera.focal_u_px, camera.focal_v_px, camera.centre_u_px, camera.centre_v_px) == (340, 325, 160, 125)
    drawn = sensor.markers.drawn_mm()
    assert drawn.shape == (63, 2)
    assert drawn.max(axis=0) == pytest.approx([8.2, 6.15])
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=1e-12)


def test_grid_is_turned_about_its_centre(tmp_path: Path) -> None:
    text = "markers: {grid: {columns: 3, rows: 1, spacing_mm: [2, 1], centre_mm: [1, -1], rotation_deg: 90}}"
    np.testing.assert_allclose(read(text, tmp_path).markers.drawn_mm(), [[1, -3], [1, -1], [1, 1]], atol=1e-12)


def test_single_markers_are_taken_as_they_are(tmp_path: Path) -> None:
    drawn = read("markers: {points_mm: [[0, 1], [2.5, -3]]}", tmp_path).markers.drawn_mm()
    np.testing.assert_array_equal(drawn, [[0, 1], [2.5, -3]])


def test_as_many_markers_as_a_picture_holds_are_taken(tmp_path: Path) -> None:
    assert len(read(f"markers: {{points_mm: {[[0, 0]] * 128}}}", tmp_path).markers.drawn_mm()) == 128
    assert len(read("markers: {grid: {columns: 16, rows: 8}}", tmp_path).markers.drawn_mm()) == 128


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("youngs_modulus_pa: 1000", "Unknown key 'youngs_modulus_pa'"),
        ("material: {friction: 2}", "Unknown key 'material'"),
        ("camera: {noise_px: 0}", "Unknown key 'camera.noise_px'"),
        ("camera: {focal_pixels: [1, 2]}", "did you mean 'focal_px'"),
        ("markers: {grid: {columns: 9, rows: 7, loss: 0}}", "Unknown key"),
        ("markers: {}", "either 'grid' or 'points_mm'"),
        ("markers: {grid: {}, points_mm: [[0, 0]]}", "either 'grid' or 'points_mm'"),
        ("markers: {points_mm: []}", "expected 1 to 128 markers, got 0"),
        ("markers: {grid: {columns: 20, rows: 7}}", "expected 1 to 128 markers, got 140"),
        (f"markers: {{points_mm: {[[0, 0]] * 129}}}", "expected 1 to 128 markers, got 129"),
        ("markers: {points_mm: [[0, .nan]]}", "finite number"),
        ("markers: {points_mm: [[0, 99]]}", "less than or equal to 15"),
        ("camera: {focal_px: [0, 325]}", "greater than or equal to 50"),
        ("camera: &a {focal_px: [340, 325]}", "anchors"),
        ("camera: !!python/object/apply:os.system [id]", "tags"),
        ("[" * 50, "not valid YAML"),
        ("- 1", "Expected a document with keys, got list"),
        (b"\xff\xfe", "not UTF-8"),
        ("a" * 17_000, "larger than 16384 bytes"),
    ],
)
def test_anything_but_design_is_refused(text: str | bytes, message: str, tmp_path: Path) -> None:
    with pytest.raises(SensorRejected, match="(?s)" + message.replace("(", r"\(")):
        read(text, tmp_path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SensorRejected, match=r"Expected sensor\.yaml in .*No such file"):
        read_sensor(tmp_path)


def test_pipe_is_refused_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "sensor.yaml")
    with pytest.raises(SensorRejected, match="no regular file"):
        read_sensor(tmp_path)


def test_size_is_limited_to_the_byte(tmp_path: Path) -> None:
    assert read(b"{}".ljust(16 * 1024), tmp_path) == SensorManifest()
    with pytest.raises(SensorRejected, match="larger than 16384 bytes"):
        read(b"{}".ljust(16 * 1024 + 1), tmp_path)
