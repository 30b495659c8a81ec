"""What of the RGB-D camera's drivers can be tried without a camera: how one is refused, and a twin's pictures."""

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.station.devices.cameras import DepthCamera, StreamedDepthCamera
from vitac.station.devices.stage import DeviceFault, DeviceNotFound, Identity
from vitac.station.twin.depth_pictures import DepthCameraTwin


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


def test_pair_of_a_twin_is_read_as_it_was_seen() -> None:
    generator = np.random.default_rng(1)
    colours = generator.integers(0, 256, (480, 640, 3), dtype=np.uint8)
    depth_m = generator.integers(0, 9000, (480, 640)).astype(np.float32) / 10_000
    sight: Any = SimpleNamespace(colours=colours, depth_m=depth_m)
    intrinsics = {"width": 640, "height": 480, "fx": 604.0, "fy": 604.0, "cx": 317.0, "cy": 234.0}
    about = {"serial_number": "D-1", "firmware": "5.13", "intrinsics": intrinsics, "units_per_m": 10_000}
    with DepthCameraTwin(look=lambda: sight, about=about) as twin, StreamedDepthCamera("D-1", twin.stream) as camera:
        assert camera.identify() == Identity(serial_number="D-1", firmware="5.13")
        assert camera.intrinsics().fx == 604.0
        seen = camera.read()
        np.testing.assert_array_equal(seen.colour[:, :, ::-1], colours)
        np.testing.assert_allclose(seen.depth_m, depth_m, atol=1e-6)
        twin.look = lambda: None
        with pytest.raises(DeviceFault, match=r"RGB-D camera D-1 at http.* does not answer: HTTP Error 503"):
            camera.read()
    with pytest.raises(DeviceNotFound, match="does not answer"):
        StreamedDepthCamera("D-1", twin.stream)
