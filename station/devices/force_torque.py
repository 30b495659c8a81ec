"""Driver of the force/torque sensor: SRI M3813A at its interface box M8128 over TCP.

The box is set up by lines of ASCII and then sends frames without being asked:

    AA 55 | length, 2 bytes, high first: 27 | number, 2 bytes | 6 float32, little endian | sum of those 24 bytes
"""

import re
import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Final, NamedTuple, Self

from .stage import DeviceFault, DeviceNotFound

_HEAD: Final = b"\xaa\x55\x00\x1b"
_FRAME: Final = struct.Struct("<4sH6fB")
_VALUES = slice(6, 30)
_ANSWER_S: Final = 2.0
_FORMAT: Final = "(A01,A02,A03,A04,A05,A06);E;1;(WMA:1)"
"""Six channels as forces and torques, one set in a frame, no mean over several."""


class Wrench(NamedTuple):
    """Force [N] and torque [N m] on the sensor."""

    force_x_n: float
    force_y_n: float
    force_z_n: float
    torque_x_nm: float
    torque_y_nm: float
    torque_z_nm: float


class ForceTorqueSensor:
    """A box with its sensor at an open connection; use it in `with`."""

    def __init__(self, host: str, port: int = 4008, *, patience: float = 1.0) -> None:
        """Connect; raise DeviceNotFound where nobody answers.

        Args:
            host: address.
            port: of its set-up and frames.
            patience: factor of the time within which it has to answer.
        """
        self._place, self._answer_s = f"{host}:{port}", _ANSWER_S * patience
        try:
            self._socket = socket.create_connection((host, port), timeout=self._answer_s)
        except OSError as error:
            raise DeviceNotFound(
                f"No force/torque box at {self._place}: {error}. Check its cable and `host`."
            ) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._pending, self._rate_hz = b"", 0
        self.damaged_bytes = 0
        """Bytes that were discarded because they belong to no frame with a correct sum."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def decoupling(self) -> list[list[float]]:
        """Return the matrix that the box turns voltages into forces with, shape [6, 6]: that of its sensor."""
        rows = re.findall(r"\(([^)]*)\)", self._ask("DCPM=?"))
        return [[float(value) for value in row.split(",")] for row in rows]

    def zero(self) -> None:
        """Take the present forces and torques for zero, before `start` and with nothing held."""
        self._ask("ADJZF=1;1;1;1;1;1")

    def start(self, rate_hz: int) -> None:
        """Set the rate and start the stream of frames, also where another program has left one running."""
        self.stop()
        self._ask("DCKMD=SUM")
        self._ask(f"SMPR={rate_hz}")
        self._ask(f"SGDM={_FORMAT}")
        self._rate_hz = rate_hz
        with self._reported():
            self._socket.sendall(b"AT+GSD\r\n")

    def zero_again(self) -> None:
        """Take the present forces and torques for zero while the stream runs, with nothing held."""
        self.stop()
        self.zero()
        self.start(self._rate_hz)

    def stop(self) -> None:
        """End the stream."""
        with self._reported():
            self._socket.sendall(b"AT+GSD=STOP\r\n")

    def read(self, *, timeout_s: float) -> list[Wrench]:
        """Return all frames that have arrived, at least one.

        Raises:
            DeviceFault: none within the time, or the connection broke.
        """
        end = monotonic() + timeout_s
        while not (frames := list(self._frames())):
            left_s = end - monotonic()
            if left_s <= 0:
                raise DeviceFault(f"The force/torque box at {self._place} sent nothing for {timeout_s} s. Restart it.")
            self._receive(left_s)
        return frames

    def _frames(self) -> Iterator[Wrench]:
        """Cut complete frames with a correct sum from what was received; skip what is damaged."""
        while (start := self._pending.find(_HEAD)) >= 0 and len(self._pending) - start >= _FRAME.size:
            frame = self._pending[start : start + _FRAME.size]
            _, _, *values, checksum = _FRAME.unpack(frame)
            is_whole = sum(frame[_VALUES]) & 0xFF == checksum
            used = start + (_FRAME.size if is_whole else 1)
            self.damaged_bytes += start if is_whole else used
            self._pending = self._pending[used:]
            if is_whole:
                yield Wrench(*values)
        if start < 0:  # the beginning of a head may be the last thing that arrived
            self.damaged_bytes += max(len(self._pending) - len(_HEAD) + 1, 0)
            self._pending = self._pending[1 - len(_HEAD) :]

    def _ask(self, command: str) -> str:
        """Send one line of set-up and return what is between `ACK+NAME=` and `$OK`; skip answers to earlier lines."""
        with self._reported():
            self._socket.sendall(f"AT+{command}\r\n".encode())
        end = monotonic() + self._answer_s
        name = command.partition("=")[0]
        answered = re.compile(rb"ACK\+(%s\b[^\r\n]*)\r\n" % re.escape(name.encode()))
        while (match := answered.search(self._pending)) is None:
            self._receive(end - monotonic())
        self._pending = self._pending[match.end() :]
        answer = match[1].decode("ascii", "replace")
        if not answer.endswith("$OK"):
            raise DeviceFault(f"The force/torque box at {self._place} refused {command!r:.60}: {answer:.80}.")
        return answer.removeprefix(f"{name}=").removesuffix("$OK")

    def _receive(self, within_s: float) -> None:
        with self._reported():
            self._socket.settimeout(max(within_s, 1e-3))
            received = self._socket.recv(65536)
            if not received:
                raise ConnectionResetError("it closed the connection")
            self._pending += received

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Raise what a broken connection raises as a fault of the device."""
        try:
            yield
        except TimeoutError as error:
            raise DeviceFault(
                f"The force/torque box at {self._place} stopped answering. Check it and restart it."
            ) from error
        except OSError as error:
            raise DeviceFault(f"The connection to the force/torque box at {self._place} broke: {error}.") from error
