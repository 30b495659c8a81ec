"""What of the RGB-D camera's driver can be tried without a camera: how it is refused."""

import sys
from types import SimpleNamespace

import pytest
from vitac.station.devices.depth_camera import DepthCamera
from vitac.station.devices.device import DeviceNotFound


def test_cameras_that_are_there_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    device = SimpleNamespace(get_info=lambda _: "821312061234")
    library = SimpleNamespace(
        camera_info=SimpleNamespace(serial_number=1),
        context=lambda: SimpleNamespace(query_devices=lambda: [device]),
    )
    monkeypatch.setitem(sys.modules, "pyrealsense2", library)
    with pytest.raises(DeviceNotFound, match=r"No RealSense with serial number 1\. Here: 821312061234\."):
        DepthCamera("1")


def test_library_that_cannot_be_loaded_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(DeviceNotFound, match=r"pyrealsense2 cannot be loaded: .*\. Install it, and libusb-1\.0\."):
        DepthCamera("1")
