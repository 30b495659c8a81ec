"""The driver of the gripper against its twin, over a real pseudo-terminal."""

import os
import time
from collections.abc import Iterator
from typing import Any

import pytest
from vitac.station.devices.gripper import Grasp, HandE
from vitac.station.devices.stage import DeviceFault, DeviceNotFound
from vitac.station.twin.gripper import GripperFault, GripperTwin, checksum
from vitac.station.twin.laboratory import Terminal


@pytest.fixture
def twin() -> GripperTwin:
    return GripperTwin()


@pytest.fixture
def line(twin: GripperTwin) -> Iterator[Terminal]:
    with Terminal(twin) as terminal:
        yield terminal


@pytest.fixture
def gripper(line: Terminal) -> Iterator[HandE]:
    with HandE(line.port) as opened:
        yield opened


def close(gripper: HandE) -> None:
    gripper.activate()
    gripper.start_move(255, speed=255, force=50)


def test_checksum_is_that_of_the_makers_example() -> None:
    # Activation request in Robotiq's manual: 09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30.
    assert checksum(bytes.fromhex("091003E8000306000000000000")) == bytes.fromhex("7330")


def test_is_inactive_until_it_is_activated(gripper: HandE) -> None:
    assert not gripper.status().is_activated
    gripper.activate()
    assert gripper.status().is_activated


def test_closing_meets_the_object(gripper: HandE) -> None:
    close(gripper)
    status = gripper.wait(timeout_s=5.0)
    assert (status.grasp, status.position, status.request) == (Grasp.MET_OBJECT_CLOSING, 180, 255)
    assert status.current > 0


def test_closing_on_nothing_ends_at_the_position(gripper: HandE, twin: GripperTwin) -> None:
    twin.object_at = None
    close(gripper)
    assert gripper.wait(timeout_s=5.0).grasp is Grasp.AT_POSITION


def test_stop_leaves_the_fingers_where_they_are(gripper: HandE, twin: GripperTwin) -> None:
    close(gripper)
    gripper.stop()
    assert twin.position() == twin.position() < 180


def test_stuck_fingers_are_a_fault(gripper: HandE, twin: GripperTwin) -> None:
    twin.faults.add(GripperFault.STUCK)
    close(gripper)
    with pytest.raises(DeviceFault, match=r"still moves after 0\.05 s, at position 0: it is stuck"):
        gripper.wait(timeout_s=0.05)


def test_reported_fault_is_named_and_activation_clears_it(gripper: HandE, twin: GripperTwin) -> None:
    close(gripper)
    twin.faults.add(GripperFault.OVERCURRENT)
    with pytest.raises(DeviceFault, match="reports fault 0x0E: overcurrent"):
        gripper.wait(timeout_s=5.0)
    gripper.activate()
    assert gripper.status().fault == 0


def test_wrong_unit_does_not_answer(line: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.station.devices.gripper._ANSWER_S", 0.02)
    with HandE(line.port, unit=8) as other, pytest.raises(DeviceFault, match="unit 8 does not answer"):
        other.status()


def test_unplugged_line_is_a_fault(gripper: HandE, line: Terminal) -> None:
    line.unplug()
    with pytest.raises(DeviceFault, match="does not answer"):
        gripper.status()


def test_a_process_that_waits_for_a_core_while_it_writes_has_not_lost_the_line(
    gripper: HandE, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write
    line: Any = gripper._line.socket

    def write_late(descriptor: int, data: bytes) -> int:
        if descriptor == line.fd:
            time.sleep(0.5)
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", write_late)
    assert not gripper.status().is_activated


def test_missing_port_is_named() -> None:
    with pytest.raises(DeviceNotFound, match="No gripper at /dev/no-such-port"):
        HandE("/dev/no-such-port")


def test_late_answer_to_a_command_is_no_status(monkeypatch: pytest.MonkeyPatch, gripper: HandE) -> None:
    line = gripper._line
    late = line.write_registers(0x03E8, [0, 0, 0], device_id=9)
    monkeypatch.setattr(line, "read_holding_registers", lambda *_, **__: late)
    with pytest.raises(DeviceFault, match="Expected 3 registers from the gripper, got 0"):
        gripper.status()


def test_pause_between_two_questions_is_no_fault(gripper: HandE, twin: GripperTwin) -> None:
    """The first answer after a second of silence has fault 9, the next one does not."""
    now_s = 0.0
    twin.clock = lambda: now_s
    gripper.activate()
    now_s = 10.0
    assert gripper.status().fault == 0
    now_s = 20.0
    assert twin._registers()[1] >> 8 == 0x09
