"""Driver of the gripper: Robotiq Hand-E by Modbus RTU, 115200 8N1. Positions, speeds and forces are its bytes."""

from dataclasses import dataclass
from enum import IntEnum
from logging import NullHandler, getLogger
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Final, Self

from .stage import DeviceFault, DeviceNotFound

if TYPE_CHECKING:
    from collections.abc import Sequence

getLogger("pymodbus").addHandler(NullHandler())  # what it has to say is in the errors here
_BAUD: Final = 115_200
_COMMAND_REGISTER: Final = 0x03E8
_STATUS_REGISTER: Final = 0x07D0
_STATUS_REGISTERS: Final = 3
_ACTIVATE, _GO = 0x01, 0x08
_ANSWER_S: Final = 0.4
_WRITE_S: Final = 5.0
"""A request of 8 bytes waits for nothing of the line, but this process may wait for a core."""
_RETRIES: Final = 3
_ACTIVATION_S: Final = 10.0
_POLL_S: Final = 0.01
_ACTIVATED: Final = 3
_WAS_SILENT: Final = 0x09
"""Nobody spoke to it for a second, as in any long motion of the stage; it reports that in its next answer."""


class Grasp(IntEnum):
    """What gOBJ says of the fingers."""

    MOVING = 0
    MET_OBJECT_OPENING = 1
    MET_OBJECT_CLOSING = 2
    AT_POSITION = 3
    """Where it was sent to: nothing is held, or it was dropped."""


@dataclass(frozen=True, kw_only=True)
class GripperStatus:
    """Status registers of a Hand-E.

    Attributes:
        is_activated: gSTA is 3.
        grasp: gOBJ.
        fault: gFLT, 0 for none.
        request: the position that it was last sent to.
        position: 0 open to 255 closed.
        current: of the motor, in units of 10 mA.
    """

    is_activated: bool
    grasp: Grasp
    fault: int
    request: int
    position: int
    current: int

    @property
    def holds_object(self) -> bool:
        """Whether closing fingers have met something."""
        return self.grasp is Grasp.MET_OBJECT_CLOSING


class HandE:
    """A Hand-E at an open serial port; use it in `with`."""

    def __init__(self, port: str, *, unit: int = 9, patience: float = 1.0) -> None:
        """Open the port; raise DeviceNotFound where there is none.

        Args:
            port: device file.
            unit: its number at the line.
            patience: factor of the times within which it has to answer and to move.
        """
        from pymodbus.client import ModbusSerialClient

        self._place = f"{port}, unit {unit}"
        self._unit, self._patience = unit, patience
        self._request: int | None = None
        self._line = ModbusSerialClient(port, baudrate=_BAUD, timeout=_ANSWER_S * patience, retries=_RETRIES)
        self._line.connect()
        if self._line.socket is None:
            raise DeviceNotFound(f"No gripper at {port}: expected a serial port. Check its cable and `port`.")
        self._line.socket.write_timeout = _WRITE_S

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._line.close()  # type: ignore[no-untyped-call]

    def status(self) -> GripperStatus:
        """Read the status registers."""
        from pymodbus import ModbusException

        try:
            answer = self._line.read_holding_registers(_STATUS_REGISTER, count=_STATUS_REGISTERS, device_id=self._unit)
        except (ModbusException, OSError) as error:
            raise self._silent(error) from error
        return _parse_status(self._accepted(answer).registers)

    def activate(self) -> None:
        """Activate the gripper, which opens and closes it once, unless it is active and has no fault."""
        status = self.status()
        if status.is_activated and not status.fault:
            return
        self._write((0, 0, 0))
        self._write((_ACTIVATE << 8, 0, 0))
        end = monotonic() + _ACTIVATION_S * self._patience
        while not (status := self.status()).is_activated:
            if monotonic() > end:
                raise DeviceFault(f"The gripper at {self._place} was not active after {_ACTIVATION_S} s. Free its way.")
            sleep(_POLL_S)
        self.check_fault(status)

    def start_move(self, position: int, *, speed: int, force: int) -> None:
        """Start to open (0) or close (255) without a check: `vitac.station.guard` makes it."""
        self._request = position
        self._write(((_ACTIVATE | _GO) << 8, position, speed << 8 | force))

    def stop(self) -> None:
        """Stop the fingers where they are."""
        self._request = None
        self._write((_ACTIVATE << 8, 0, 0))

    def wait(self, *, timeout_s: float) -> GripperStatus:
        """Return the status when the fingers have come to rest after `start_move`.

        Args:
            timeout_s: without patience.

        Raises:
            DeviceFault: still moving after the time, or the gripper reports a fault.
        """
        timeout_s *= self._patience
        end = monotonic() + timeout_s
        while (status := self.status()).grasp is Grasp.MOVING or status.request != self._request:
            self.check_fault(status)
            if monotonic() > end:
                raise DeviceFault(
                    f"The gripper at {self._place} still moves after {timeout_s} s, at position {status.position}: "
                    "it is stuck. Free it, then activate it again."
                )
            sleep(_POLL_S)
        self.check_fault(status)
        return status

    def _write(self, registers: "Sequence[int]") -> None:
        from pymodbus import ModbusException

        try:
            answer = self._line.write_registers(_COMMAND_REGISTER, list(registers), device_id=self._unit)
        except (ModbusException, OSError) as error:
            raise self._silent(error) from error
        self._accepted(answer)

    def _accepted(self, answer: Any) -> Any:
        if answer.isError():
            raise DeviceFault(f"The gripper at {self._place} refused: {answer}. Is it a Hand-E?")
        return answer

    def _silent(self, error: Exception) -> DeviceFault:
        return DeviceFault(f"The gripper at {self._place} does not answer: {error}. Check its power and `unit`.")

    def check_fault(self, status: GripperStatus) -> None:
        """Raise DeviceFault if a status has a fault."""
        if status.fault:
            meaning = _FAULTS.get(status.fault, "see its manual")
            raise DeviceFault(f"The gripper at {self._place} reports fault 0x{status.fault:02X}: {meaning}.")


_FAULTS: Final = {
    0x05: "the action waits for activation",
    0x07: "it must be activated first",
    0x08: "it is too hot, let it cool below 80 degrees",
    0x0A: "its supply is below its minimum voltage",
    0x0B: "automatic release is in progress",
    0x0C: "internal fault, contact its maker",
    0x0D: "activation failed, free its way",
    0x0E: "overcurrent",
    0x0F: "automatic release is done, activate it again",
}


def _parse_status(registers: "Sequence[int]") -> GripperStatus:
    if len(registers) != _STATUS_REGISTERS:  # the late answer to an earlier request
        raise DeviceFault(
            f"Expected {_STATUS_REGISTERS} registers from the gripper, got {len(registers)}. Ask it again."
        )
    state, fault = registers[0] >> 8, registers[1] >> 8 & 0x0F
    return GripperStatus(
        is_activated=(state >> 4) & 3 == _ACTIVATED,
        grasp=Grasp((state >> 6) & 3),
        fault=0 if fault == _WAS_SILENT else fault,
        request=registers[1] & 0xFF,
        position=registers[2] >> 8,
        current=registers[2] & 0xFF,
    )
