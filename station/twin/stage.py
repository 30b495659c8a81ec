"""Twin of the stage: what a controller with GRBL 1.1 and four axes answers, and how it would move meanwhile.

It moves along straight lines with the speed profile of a trapezoid, as GRBL does between rests.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from threading import Lock
from time import monotonic
from typing import Final

Axes = tuple[float, float, float, float]

_WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d*)?|-?\.\d+)")
_AXES: Final = "XYZA"
_WELCOME: Final = "\r\nGrbl 1.1h ['$' for help]\r\n"


class StageFault(StrEnum):
    """What a script can break."""

    ALARM = "ALARM:1"
    """The next motion runs into a limit switch."""
    SILENT = "silent"
    """It answers nothing."""


@dataclass(frozen=True)
class Motion:
    """A straight motion from rest to rest; a hold cuts it off.

    Attributes:
        start: where it begins [mm, deg].
        end: where it ends.
        began_s: when.
        speed: of its middle part, over all four axes [mm or deg / s].
        acceleration: of its ends [mm or deg / s^2].
    """

    start: Axes
    end: Axes
    began_s: float
    speed: float
    acceleration: float

    @property
    def length(self) -> float:
        """Length over all four axes."""
        return math.dist(self.start, self.end)

    @property
    def duration_s(self) -> float:
        """Time from rest to rest."""
        top = self._top_speed()
        return top / self.acceleration + self.length / top if top else 0.0

    def travelled(self, at_s: float) -> tuple[float, float]:
        """Return length travelled and speed at a time."""
        top, total = self._top_speed(), self.duration_s
        elapsed = min(max(at_s - self.began_s, 0.0), total)
        ramp = top / self.acceleration
        if elapsed < ramp:
            return 0.5 * self.acceleration * elapsed**2, self.acceleration * elapsed
        if elapsed > total - ramp:
            left = total - elapsed
            return self.length - 0.5 * self.acceleration * left**2, self.acceleration * left
        return 0.5 * top * ramp + top * (elapsed - ramp), top

    def at(self, length: float) -> Axes:
        """Return the position after a length."""
        part = length / self.length if self.length else 1.0
        x, y, z, a = (a + part * (b - a) for a, b in zip(self.start, self.end, strict=True))
        return x, y, z, a

    def _top_speed(self) -> float:
        return min(self.speed, math.sqrt(self.acceleration * self.length))


def _default_settings() -> dict[int, float]:
    steps, speeds, accelerations, travel = (400, 400, 400, 80), (1200,) * 4, (500,) * 4, (200,) * 4
    rows = {100: steps, 110: speeds, 120: accelerations, 130: travel}
    by_axis = {number + axis: float(row[axis]) for number, row in rows.items() for axis in range(4)}
    return {10: 1.0, 20: 1.0, 22: 1.0} | by_axis


@dataclass(kw_only=True)
class StageTwin:
    """A stage; give it to a `Terminal`.

    Attributes:
        serial_number: the text stored in it.
        settings: GRBL's settings.
        clock: the time that it moves by.
        faults: what is broken now.
        held_s: when the last `!` arrived.
        rest_s: when the last held motion was at rest.
    """

    serial_number: str = "STAGE-1"
    firmware: str = "1.1h.20190825"
    settings: dict[int, float] = field(default_factory=_default_settings)
    clock: Callable[[], float] = monotonic
    faults: set[StageFault] = field(default_factory=set)
    held_s: float | None = None
    rest_s: float | None = None
    _position: Axes = (0.0, 0.0, 0.0, 0.0)
    _motion: Motion | None = None
    _alarm: bool = False
    _locked: bool = False  # a limit was met: GRBL takes nothing but a reset
    _line: str = ""
    _lock: Lock = field(default_factory=Lock)

    def axes(self) -> Axes:
        """Return where its encoders say it is."""
        with self._lock:
            return self._now()[0]

    def receive(self, data: bytes) -> bytes:
        """Obey real-time bytes at once and lines when they are complete."""
        with self._lock:
            answers = "".join(self._take(chr(byte)) for byte in data)
        return b"" if StageFault.SILENT in self.faults else answers.encode()

    def position(self) -> Axes:
        """Return where the stage is now."""
        with self._lock:
            return self._now()[0]

    def speed(self) -> float:
        """Return its speed over all four axes now."""
        with self._lock:
            return self._now()[1]

    def _take(self, character: str) -> str:
        if self._locked and character != "\x18":
            return ""
        if character == "?":
            return self._report()
        if character == "!":
            self._hold()
        elif character == "\x18":
            return self._reset()
        elif character == "\n":
            line, self._line = self._line.strip().upper(), ""
            return self._answer(line)
        elif character != "\r":
            self._line += character
        return ""

    def _now(self) -> tuple[Axes, float]:
        if self._motion is None:
            return self._position, 0.0
        at_s = self.clock()
        if self.held_s is None:
            length, speed = self._motion.travelled(at_s)
        else:
            length, top = self._motion.travelled(self.held_s)
            brake_s = top / self._motion.acceleration
            braked_s = min(at_s - self.held_s, brake_s)
            speed = top - self._motion.acceleration * braked_s if braked_s < brake_s else 0.0
            length += 0.5 * (top + speed) * braked_s
        return self._motion.at(length), speed

    def _hold(self) -> None:
        if self._motion is None or self.held_s is not None or self._ended():
            return
        self.held_s = self.clock()
        self.rest_s = self.held_s + self._motion.travelled(self.held_s)[1] / self._motion.acceleration

    def _ended(self) -> bool:
        return self._motion is None or self.clock() >= self._motion.began_s + self._motion.duration_s

    def _report(self) -> str:
        position, speed = self._now()
        if self._alarm:
            state = "Alarm"
        elif self.held_s is not None:
            state = "Hold:1" if speed else "Hold:0"
        else:
            state = "Idle" if self._ended() else "Run"
        places = ",".join(f"{value:.3f}" for value in position)
        return f"<{state}|MPos:{places}|FS:{60 * speed:.0f},0>\r\n"

    def _reset(self) -> str:
        self._position, speed = self._now()
        self._motion, self.held_s, self._line, self._locked = None, None, "", False
        lost = "ALARM:3\r\n" if speed else ""
        self._alarm = self._alarm or bool(speed)
        return lost + _WELCOME

    def _answer(self, line: str) -> str:
        if self.held_s is not None:
            return ""  # GRBL reads no lines in a hold
        if line == "$I":
            return f"[VER:{self.firmware}:{self.serial_number}]\r\n[OPT:V,15,128]\r\nok\r\n"
        if line == "$$":
            return "".join(f"${number}={value:.3f}\r\n" for number, value in self.settings.items()) + "ok\r\n"
        if line == "$H":
            self._position, self._motion, self._alarm = (0.0, 0.0, 0.0, 0.0), None, False
            return "ok\r\n"
        if line == "$X":
            self._alarm = False
            return "[MSG:Caution: Unlocked]\r\nok\r\n"
        if self._alarm:
            return "error:9\r\n"
        return self._start(dict(_WORD.findall(line.replace("G90", "").replace("G94", ""))))

    def _lock_up(self, alarm: str) -> str:
        self._alarm = self._locked = True
        return f"{alarm}\r\n[MSG:Reset to continue]\r\n"

    def _start(self, words: dict[str, str]) -> str:
        """Begin a motion; the one before has ended, as the driver sends one at a time."""
        start = self._now()[0]
        x, y, z, a = (float(words.get(axis, start[number])) for number, axis in enumerate(_AXES))
        if float(words.get("F", 0)) <= 0:
            return "error:22\r\n"
        if self.settings[20] and any(abs(value) > self.settings[130 + n] for n, value in enumerate((x, y, z, a))):
            return self._lock_up("ALARM:2")
        if StageFault.ALARM in self.faults:
            return self._lock_up("ALARM:1")
        self._position = start
        self._motion = Motion(start, (x, y, z, a), self.clock(), float(words["F"]) / 60, self.settings[120])
        return "ok\r\n"
