"""Driver of the stage, GRBL 1.1 over a serial line, and what all drivers share: identity, and how a device fails.

Positions are absolute, in mm and degrees. One command is sent at a time and answered with `ok`; `?`, `!` and Ctrl-X are
single bytes that GRBL obeys at any time.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from errno import EWOULDBLOCK
from threading import Lock
from time import monotonic, sleep
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from vitac.errors import VitacError

if TYPE_CHECKING:
    from serial import Serial


class DeviceNotFound(VitacError):
    """Nothing answers at the device's address; check cable, power and the address in the station's file."""


class DeviceInUse(DeviceNotFound):
    """Another program talks to the device, perhaps while it moves; end that one first."""


class DeviceFault(VitacError):
    """A device answers wrongly, reports a fault or stopped answering; the message says which and what to do."""


@dataclass(frozen=True, kw_only=True)
class Identity:
    """What a device reports about itself; None for what it does not report."""

    serial_number: str | None = None
    firmware: str | None = None


_BAUD: Final = 115_200
_ANSWER_S: Final = 1.0
_HOME_S: Final = 120.0
_POLL_S: Final = 0.01
_TRIES: Final = 3
_HOLD, _RESET, _STATUS = b"!", b"\x18", b"?"
_FIELD = re.compile(r"(\w+):([^|>]*)")


class Pose(NamedTuple):
    """Position of the four axes."""

    x_mm: float
    y_mm: float
    z_mm: float
    rotation_deg: float


class GrblState(StrEnum):
    """State of GRBL's machine, as it names it."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    HOME = "Home"
    ALARM = "Alarm"
    OTHER = "Other"
    """Jog, door, check or sleep: nothing that this driver asks for."""


class StageSilent(DeviceFault):
    """The controller did not answer in time; check its power, then home it again."""


@dataclass(frozen=True, kw_only=True)
class StageStatus:
    """One answer to `?`.

    Attributes:
        state: of the machine.
        is_moving: false once a hold has come to rest, and when idle.
        pose: where the controller counts that its axes are.
    """

    state: GrblState
    is_moving: bool
    pose: Pose


class LinearStage:
    """A stage at an open serial port; use it in `with`."""

    def __init__(self, port: str, *, patience: float = 1.0) -> None:
        """Open the port for this program alone.

        Args:
            port: device file.
            patience: factor of the time within which it has to answer.

        Raises:
            DeviceInUse: another program has it.
            DeviceNotFound: there is none, or nothing answers at it.
        """
        self._lock, self._port, self._patience = Lock(), port, 1.0
        self._line = _open_line(port, patience)
        self._await_start(patience)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._line.close()

    def identify(self) -> Identity:
        """Return version and stored text of `$I`: [VER:version:text]."""
        for line in self._command("$I"):
            if match := re.fullmatch(r"\[VER:([^:\]]*):([^\]]*)\]", line):
                return Identity(firmware=match[1], serial_number=match[2] or None)
        raise DeviceFault(f"Stage at {self._port}: expected [VER:...] after $I, got none. Is it GRBL 1.1?")

    def settings(self) -> dict[int, float]:
        """Return GRBL's settings `$0` to `$133` by number."""
        matches = (re.fullmatch(r"\$(\d+)=(\S+).*", line) for line in self._command("$$"))
        return {int(each[1]): float(each[2]) for each in matches if each}

    def status(self) -> StageStatus:
        """Ask for state and position; works during a motion.

        Raises:
            DeviceFault: the controller goes into alarm, or does not answer; after an alarm it is silent until a reset.
        """
        with self._lock, self._reported():
            self._line.write(_STATUS)
            for line in self._lines(_ANSWER_S):
                if line.startswith("<"):
                    return _parse_status(line)
                if line.startswith("ALARM:"):
                    raise DeviceFault(f"The stage went into alarm, {line}. {_REMEDIES.get(line, _LOOK_UP)}")
        raise AssertionError  # lines end only in an exception

    def home(self) -> None:
        """Reset the controller, which a limit switch has locked, and drive all axes to their switches."""
        self.forget_motion()
        self._command("$H", answer_s=_HOME_S)

    def unlock(self) -> None:
        """Reset the controller and end its alarm where the stage stands; the position may be some steps off."""
        self.forget_motion()
        self._command("$X")

    def start_move(self, target: Pose, *, feed: float) -> None:
        """Start a straight motion without a check: `vitac.station.guard` makes it.

        Args:
            target: where to.
            feed: length of the motion over all four axes per minute, as GRBL counts it [mm or deg / min].
        """
        x, y, z, rotation = target
        self._command(f"G90 G21 G94 G1 X{x:.4f} Y{y:.4f} Z{z:.4f} A{rotation:.4f} F{feed:.3f}")

    def hold(self) -> None:
        """Slow down to rest at once: one byte, sent even while another thread waits for an answer."""
        with self._reported():
            self._line.write(_HOLD)

    @contextmanager
    def held_if_killed(self) -> Iterator[None]:
        """Hold the stage when this process ends inside the block, even by SIGKILL: another process waits for it."""
        ended, alive = os.pipe()
        line = self._line.fileno()
        program = f"import os\nif not os.read({ended}, 1): os.write({line}, {_HOLD!r})"
        waiting = subprocess.Popen([sys.executable, "-ISc", program], pass_fds=(ended, line), start_new_session=True)  # noqa: S603 - our own
        os.close(ended)
        try:
            yield
        finally:
            os.write(alive, b"x")
            os.close(alive)
            waiting.wait()

    def forget_motion(self) -> None:
        """Discard what is left of a held motion; the position stays known, as the stage is at rest."""
        with self._lock, self._reported():
            self._line.write(_RESET)
            next(line for line in self._lines(_ANSWER_S) if line.startswith("Grbl"))

    def _await_start(self, patience: float) -> None:
        """Wait until the controller answers.

        Behind an Arduino's USB it restarts when its port is opened. After a limit switch it answers nothing until it is
        reset, however long it is waited for; its alarm stays.
        """
        for _ in range(_TRIES):
            try:
                self.status()
            except StageSilent:
                self._patience = patience
                with self._reported():
                    self._line.write(_RESET)
                continue
            self._patience = patience
            return
        self._line.close()
        raise DeviceNotFound(f"Nothing answers at {self._port}: expected GRBL 1.1. Check its power and `port`.")

    def _command(self, text: str, *, answer_s: float = _ANSWER_S) -> list[str]:
        """Send a line and return what is answered before `ok`."""
        answered: list[str] = []
        with self._lock, self._reported():
            self._line.write(text.encode() + b"\n")
            for line in self._lines(answer_s):
                if line == "ok":
                    return answered
                if line.startswith(("error:", "ALARM:")):
                    raise DeviceFault(f"Stage refused {text!r}: {line}. {_REMEDIES.get(line, _LOOK_UP)}")
                answered.append(line)
        raise AssertionError  # lines end only in an exception

    def _lines(self, within_s: float) -> Iterator[str]:
        """Yield lines that arrive within a time, without empty ones; one that waits for this process is not late."""
        within_s *= self._patience
        end = monotonic() + within_s
        pending, is_over = b"", False
        while not is_over or pending.endswith(b"\n"):
            if pending.endswith(b"\n"):
                line, pending = pending.decode("ascii", "replace").strip(), b""
                if line:
                    yield line
            is_over = monotonic() > end
            pending += self._line.readline()
        raise StageSilent(f"Stage at {self._port} did not answer within {within_s} s. Check its power; home it again.")

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Raise what a broken line raises as a fault of the device."""
        from serial import SerialException

        try:
            yield
        except (SerialException, OSError) as error:
            raise DeviceFault(f"The line to the stage at {self._port} broke: {error}. Check its cable.") from error


def _open_line(port: str, patience: float) -> "Serial":
    """Open a port for this program alone; wait for the process that holds the stage of a killed one to end."""
    from serial import Serial, SerialException

    end = monotonic() + _ANSWER_S
    while True:
        try:
            return Serial(port, _BAUD, timeout=0.02, write_timeout=_ANSWER_S * patience, exclusive=True)
        except (SerialException, OSError) as error:
            if error.errno != EWOULDBLOCK:
                raise DeviceNotFound(f"No stage at {port}: {error}. Check its cable and `port` in the file.") from error
            if monotonic() > end:
                raise DeviceInUse(f"The stage at {port} is used by another program. End that one first.") from error
        sleep(_POLL_S)


_LOOK_UP: Final = "GRBL's manual lists the codes."
_REMEDIES: Final = {
    "error:9": "It is locked by an alarm: clear its way, then home it.",
    "error:15": "The target is beyond its travel.",
    "ALARM:1": "It met a limit switch and lost its position: clear its way, then home it.",
    "ALARM:2": "The target is beyond its travel: correct the workspace in the file.",
    "ALARM:8": "Homing did not find a switch: check it.",
    "ALARM:9": "Homing did not find a switch: check it.",
}


def _parse_status(line: str) -> StageStatus:
    word, _, detail = line[1:].partition("|")[0].rstrip(">").partition(":")
    fields = dict(_FIELD.findall(line))
    try:
        pose = Pose(*map(float, fields["MPos"].split(",")))
    except (KeyError, ValueError, TypeError) as error:
        raise DeviceFault(
            f"Expected MPos of four axes from the stage, got {line!r:.80}. Set $10=1 and connect the rotary axis as A."
        ) from error
    state = GrblState(word) if word in set(GrblState) else GrblState.OTHER
    at_rest = state in (GrblState.IDLE, GrblState.ALARM) or (state is GrblState.HOLD and detail == "0")
    return StageStatus(state=state, is_moving=not at_rest, pose=pose)
