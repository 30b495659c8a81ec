"""The driver of the force/torque sensor against its twin, over a real TCP connection."""

from collections.abc import Iterator

import pytest
from vitac.station.devices.force_torque import ForceTorqueSensor, Wrench
from vitac.station.devices.stage import DeviceFault, DeviceNotFound
from vitac.station.twin.force_torque import ForceTorqueFault, ForceTorqueTwin

PRESSED = (1.5, -2.25, 40.0, 0.125, 0.25, -0.5)


@pytest.fixture
def twin() -> Iterator[ForceTorqueTwin]:
    with ForceTorqueTwin(wrench=lambda: PRESSED) as box:
        yield box


@pytest.fixture
def sensor(twin: ForceTorqueTwin) -> Iterator[ForceTorqueSensor]:
    with ForceTorqueSensor("127.0.0.1", twin.port) as opened:
        yield opened


def read(sensor: ForceTorqueSensor, frames: int) -> list[Wrench]:
    found: list[Wrench] = []
    while len(found) < frames:
        found += sensor.read(timeout_s=5.0)
    return found


def test_frames_are_forces_and_torques(sensor: ForceTorqueSensor) -> None:
    sensor.start(rate_hz=1000)
    assert read(sensor, 5)[4] == Wrench(*PRESSED)
    assert sensor.damaged_bytes == 0


def test_zero_is_the_force_at_which_it_was_set(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    sensor.zero()
    twin.wrench = lambda: (2.5, -2.25, 40.0, 0.125, 0.25, 0.0)
    sensor.start(rate_hz=1000)
    assert read(sensor, 2)[1] == Wrench(1.0, 0.0, 0.0, 0.0, 0.0, 0.5)


def test_damaged_frames_are_skipped_and_counted(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    twin.faults.add(ForceTorqueFault.DAMAGED)
    sensor.start(rate_hz=1000)
    assert set(read(sensor, 5)) == {Wrench(*PRESSED)}
    assert sensor.damaged_bytes >= 4 * 31


def test_noise_between_frames_is_skipped(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    sensor.start(rate_hz=1000)
    (frame,) = sensor.read(timeout_s=5.0)[:1]
    sensor._pending = b"\xaa\x55\xaa\xaa\x55"
    assert read(sensor, 2)[1] == frame
    assert sensor.damaged_bytes > 0


def test_started_stream_can_be_started_again(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    """The box acknowledges the end of the first stream before it answers to the set-up of the second one."""
    sensor.start(rate_hz=1000)
    read(sensor, 2)
    sensor.start(rate_hz=500)
    assert read(sensor, 2)[1] == Wrench(*PRESSED)


def test_decoupling_is_that_of_the_sensor(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    twin.decoupling[0][3] = -116.59568
    assert sensor.decoupling() == twin.decoupling


def test_refused_set_up_is_a_fault(sensor: ForceTorqueSensor) -> None:
    with pytest.raises(DeviceFault, match=r"refused 'SMPR=-1': SMPR=-1\$ERROR"):
        sensor.start(rate_hz=-1)


def test_frozen_stream_is_a_fault(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    twin.faults.add(ForceTorqueFault.FROZEN)
    sensor.start(rate_hz=1000)
    with pytest.raises(DeviceFault, match="stopped answering"):
        sensor.read(timeout_s=0.05)


def test_cut_network_is_a_fault(sensor: ForceTorqueSensor, twin: ForceTorqueTwin) -> None:
    sensor.start(rate_hz=1000)
    twin.cut()
    with pytest.raises(DeviceFault, match=r"connection to the force/torque box at \S+ broke"):
        read(sensor, 1000)


def test_nobody_at_the_address_is_named(twin: ForceTorqueTwin) -> None:
    twin.cut()
    with pytest.raises(DeviceNotFound, match=r"No force/torque box at 127\.0\.0\.1"):
        ForceTorqueSensor("127.0.0.1", 1)
