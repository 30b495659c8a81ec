"""The driver of a tactile camera against its twin, over a real stream; and how it finds a USB camera."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from vitac.station.devices.cameras import GelSightCamera, find_camera
from vitac.station.devices.stage import DeviceFault, DeviceNotFound
from vitac.station.twin.pictures import CameraFault, CameraTwin

SERIAL = "28F0-GX7F"


def noisy_pictures() -> CameraTwin:
    generator = np.random.default_rng(1)
    return CameraTwin(
        picture=lambda: generator.integers(90, 110, (48, 64, 3)).astype(np.uint8),
        period_s=0.001,
    )


@pytest.fixture
def twin() -> Iterator[CameraTwin]:
    with noisy_pictures() as camera:
        yield camera


@pytest.fixture
def camera(twin: CameraTwin) -> Iterator[GelSightCamera]:
    with GelSightCamera(SERIAL, stream=twin.stream) as opened:
        yield opened


def list_camera(cameras: Path, node: str, name: str, index: int = 0) -> None:
    (cameras / node).mkdir()
    (cameras / node / "name").write_text(name + "\n")
    (cameras / node / "index").write_text(f"{index}\n")


def test_pictures_arrive_one_after_the_other(camera: GelSightCamera) -> None:
    first, second = camera.read(), camera.read()
    assert first.shape == (48, 64, 3)
    assert abs(float(first.mean()) - 100.0) < 2.0
    assert not np.array_equal(first, second)


def test_frozen_stream_is_a_fault(camera: GelSightCamera, twin: CameraTwin) -> None:
    camera.read()
    twin.faults.add(CameraFault.FROZEN)
    with pytest.raises(DeviceFault, match=r"28F0-GX7F is frozen: 11 equal pictures"):
        [camera.read() for _ in range(1000)]


def test_unplugged_camera_is_a_fault(camera: GelSightCamera, twin: CameraTwin) -> None:
    camera.read()
    twin.faults.add(CameraFault.UNPLUGGED)
    with pytest.raises(DeviceFault, match="28F0-GX7F stopped sending pictures"):
        [camera.read() for _ in range(1000)]


def test_stream_that_is_not_there_is_not_found(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(DeviceNotFound, match="cannot be opened"):
        GelSightCamera(SERIAL, stream="http://127.0.0.1:1/none")


def test_camera_is_found_by_the_serial_number_in_its_name(tmp_path: Path) -> None:
    list_camera(tmp_path, "video0", "Webcam")
    list_camera(tmp_path, "video2", "GelSight Mini R0B 28F0-GX7F: Ge", index=1)
    list_camera(tmp_path, "video3", "GelSight Mini R0B 28F0-GX7F: Ge")
    assert find_camera(SERIAL, tmp_path) == "/dev/video3"


def test_cameras_that_are_there_are_named(tmp_path: Path) -> None:
    list_camera(tmp_path, "video2", "GelSight Mini R0B 28W2-TRN5: Ge")
    with pytest.raises(DeviceNotFound, match=r"Cameras here: GelSight Mini R0B 28W2-TRN5: Ge\."):
        GelSightCamera(SERIAL, cameras=tmp_path)
    with pytest.raises(DeviceNotFound, match=r"Cameras here: none\."):
        find_camera(SERIAL, tmp_path / "no-such-folder")
