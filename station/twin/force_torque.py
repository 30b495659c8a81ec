"""Twin of the force/torque box: a TCP server that sends its frames at the rate it was set to."""

import re
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from threading import Event, Thread
from time import monotonic
from typing import Self

Values = tuple[float, float, float, float, float, float]
Matrix = list[list[float]]


class ForceTorqueFault(StrEnum):
    """What a script can break."""

    FROZEN = "frozen"
    """It sends no frames."""
    DAMAGED = "damaged"
    """Every second frame has a wrong sum."""
    UNREACHABLE = "unreachable"
    """The network is cut: connections end at once."""


def _identity() -> Matrix:
    return [[float(row == column) for column in range(6)] for row in range(6)]


@dataclass(kw_only=True)
class ForceTorqueTwin:
    """A box; use it in `with`.

    Attributes:
        wrench: gives the force [N] and torque [N m] when a frame is sent.
        decoupling: matrix of its sensor.
        faults: what is broken now.
        sent: number of frames and the time of the last one.
    """

    wrench: Callable[[], Values] = lambda: (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    decoupling: Matrix = field(default_factory=_identity)
    faults: set[ForceTorqueFault] = field(default_factory=set)
    sent: int = 0
    _zero: Values = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    _rate_hz: float = 100.0
    _streams: bool = False
    _over: Event = field(default_factory=Event)
    _connection: socket.socket | None = None

    def __enter__(self) -> Self:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._thread = Thread(target=self._serve, name="twin of the force/torque box", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.cut()
        self._thread.join()

    def cut(self) -> None:
        """Cut the network: close the connection and accept no other."""
        self._over.set()
        _shut(self._connection)
        _shut(self._server)

    def cut_for_a_while(self) -> None:
        """Cut the network until the fault is taken away."""
        self.faults.add(ForceTorqueFault.UNREACHABLE)
        _shut(self._connection)

    def _serve(self) -> None:
        while not self._over.is_set():
            try:
                self._connection, _ = self._server.accept()
                if ForceTorqueFault.UNREACHABLE in self.faults:
                    self._connection.close()
                    continue
                self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._talk(self._connection)
            except OSError:
                continue  # the driver left, or the network was cut
        self._server.close()

    def _talk(self, connection: socket.socket) -> None:
        self._streams, pending, due_s = False, b"", monotonic()
        with connection:
            while not self._over.is_set():
                connection.settimeout(max(due_s - monotonic(), 1e-4) if self._streams else None)
                try:
                    received = connection.recv(4096)
                    if not received:
                        return
                    pending += received
                except TimeoutError:
                    self._send(connection)
                    due_s = max(due_s + 1 / self._rate_hz, monotonic() - 0.1)
                *lines, pending = pending.split(b"\r\n")
                for line in lines:
                    connection.sendall(self._answer(line.decode("ascii", "replace")))
                    due_s = monotonic()

    def _answer(self, line: str) -> bytes:
        if line == "AT+GSD":
            self._streams = True
            return b""
        if line == "AT+GSD=STOP":
            self._streams = False
            answer = "GSD=STOP$OK"
        elif line == "AT+DCKMD=SUM":
            answer = "DCKMD=SUM$OK"
        elif match := re.fullmatch(r"AT\+SMPR=(\d+)", line):
            self._rate_hz = float(match[1])
            answer = f"SMPR={match[1]}$OK"
        elif line == "AT+DCPM=?":
            rows = ";".join("(" + ",".join(f"{value:.6f}" for value in row) + ")" for row in self.decoupling)
            answer = f"DCPM={rows}$OK"
        elif line == "AT+ADJZF=1;1;1;1;1;1":
            self._zero = self.wrench()
            answer = "ADJZF=1;1;1;1;1;1$OK"
        elif match := re.fullmatch(r"AT\+(SGDM=.*)", line):
            answer = f"{match[1]}$OK"
        else:
            answer = f"{line.removeprefix('AT+')}$ERROR"
        return f"ACK+{answer}\r\n".encode()

    def _send(self, connection: socket.socket) -> None:
        if ForceTorqueFault.FROZEN in self.faults:
            return
        values = struct.pack("<6f", *(value - zero for value, zero in zip(self.wrench(), self._zero, strict=True)))
        is_damaged = ForceTorqueFault.DAMAGED in self.faults and self.sent % 2
        total = (sum(values) + bool(is_damaged)) & 0xFF
        self.sent += 1
        connection.sendall(struct.pack(">2sHH", b"\xaa\x55", 27, self.sent & 0xFFFF) + values + bytes((total,)))


def _shut(connection: socket.socket | None) -> None:
    if connection is not None:
        try:
            connection.shutdown(socket.SHUT_RDWR)
        except OSError:
            return  # it was closed already
