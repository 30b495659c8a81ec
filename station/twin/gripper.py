"""Twin of the gripper: a Hand-E behind Modbus RTU, its frames cut and summed here by hand."""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from time import monotonic
from typing import Final

_COMMAND, _STATUS = 0x03E8, 0x07D0
_READ, _WRITE = 0x03, 0x10
_ACTIVATED, _ACTIVATING = 3, 1
_SILENCE_S: Final = 1.0
"""Without communication for this long it reports a fault, once."""
_CLOSING_PER_S: Final = 1000.0
"""Position bytes a second at the greatest speed; the real one takes a third of a second for its stroke."""


class GripperFault(StrEnum):
    """What a script can break."""

    SILENT = "silent"
    """It answers nothing."""
    STUCK = "stuck"
    """Its fingers do not move, and it reports that they are moving."""
    OVERCURRENT = "overcurrent"


@dataclass(kw_only=True)
class GripperTwin:
    """A Hand-E; give it to a `Terminal`.

    Attributes:
        object_at: position at which closing fingers meet an object; None if there is none.
        clock: the time that it moves by.
        faults: what is broken now.
    """

    unit: int = 9
    object_at: int | None = 180
    clock: Callable[[], float] = monotonic
    faults: set[GripperFault] = field(default_factory=set)
    _command: tuple[int, int, int] = (0, 0, 0)
    _start: float = 0.0
    _began_s: float = 0.0
    _data: bytes = b""
    _heard_s: float = -math.inf

    def receive(self, data: bytes) -> bytes:
        """Answer each complete request for this unit."""
        self._data += data
        answers = b""
        while length := self._request_length():
            request, self._data = self._data[:length], self._data[length:]
            if checksum(request[:-2]) == request[-2:] and request[0] == self.unit:
                answers += self._answer(request)
        return b"" if GripperFault.SILENT in self.faults else answers

    def position(self) -> float:
        """Return where the fingers are, 0 open to 255 closed."""
        target, reach = self._target()
        step = reach * (self.clock() - self._began_s)
        return min(self._start + step, target) if target > self._start else max(self._start - step, target)

    @property
    def force(self) -> int:
        """Force of the last command, 0 to 255."""
        return self._command[2] & 0xFF

    def stick(self) -> None:
        """Leave the fingers where they are."""
        self._start, self._began_s = self.position(), self.clock()
        self.faults.add(GripperFault.STUCK)

    def _request_length(self) -> int:
        """Return the length of the first request if it is complete, else 0."""
        if len(self._data) < 8:
            return 0
        length = 9 + self._data[6] if self._data[1] == _WRITE else 8
        return length if len(self._data) >= length else 0

    def _answer(self, request: bytes) -> bytes:
        unit, function, start, count = struct.unpack(">BBHH", request[:6])
        if (function, start, count) == (_READ, _STATUS, 3):
            body = struct.pack(">BBB3H", unit, function, 6, *self._registers())
        elif (function, start, count) == (_WRITE, _COMMAND, 3):
            self._obey(struct.unpack(">3H", request[7:13]))
            body = request[:6]
        else:
            body = bytes((unit, function | 0x80, 2))  # no such address
        return body + checksum(body)

    def _obey(self, command: tuple[int, int, int]) -> None:
        self._heard_s = self.clock()
        self._start, self._began_s, self._command = self.position(), self.clock(), command
        if not command[0] >> 8 & 1:
            self.faults.discard(GripperFault.OVERCURRENT)

    def _target(self) -> tuple[float, float]:
        """Return where the fingers go and how fast."""
        if not self._command[0] >> 8 & 0x08 or GripperFault.STUCK in self.faults:
            return self._start, 0.0
        wanted = float(self._command[1] & 0xFF)
        if self.object_at is not None and self._start <= self.object_at:
            wanted = min(wanted, self.object_at)
        return wanted, _CLOSING_PER_S * (0.1 + 0.9 * (self._command[2] >> 8) / 255)

    def _registers(self) -> tuple[int, int, int]:
        is_active, goes = self._command[0] >> 8 & 1, self._command[0] >> 8 & 0x08
        wanted, place = self._command[1] & 0xFF, round(self.position())
        state = (
            is_active | goes | (_ACTIVATED if is_active else 0) << 4 | (self._met(wanted, place) if goes else 3) << 6
        )
        is_unheard, self._heard_s = self.clock() - self._heard_s > _SILENCE_S, self.clock()
        fault = 0x0E if GripperFault.OVERCURRENT in self.faults else 0x09 if is_unheard else 0
        return state << 8, fault << 8 | wanted, place << 8 | (20 if self._met(wanted, place) == 2 else 0)

    def _met(self, wanted: int, place: int) -> int:
        """Return gOBJ: 0 moving, 2 met an object while closing, 3 at its position."""
        if GripperFault.STUCK in self.faults:
            return 0
        if place == wanted:
            return 3
        return 2 if place == self.object_at and wanted > place else 0


def checksum(data: bytes) -> bytes:
    """Return the CRC of Modbus RTU, low byte first."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return struct.pack("<H", crc)
