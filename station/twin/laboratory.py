"""Twins of all devices of a station, the file that describes them, and the process and serial lines that they use."""

import os
import tty
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any, Final, Protocol, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from vitac.envs.vision.optics import COLOUR_INTRINSICS, HEIGHT_PX, WIDTH_PX

from ..description import StationTask, TwinMark
from .bench import Bench
from .depth_pictures import UNITS_PER_M, DepthCameraTwin
from .force_torque import ForceTorqueTwin
from .gel_view import SMALL_CAMERA, marker_grid
from .grasp import CUBOID_PEG, HOLE, Mounted
from .gripper import GripperTwin
from .hidden import PUBLIC_TWIN, FaultScript, HiddenSettings, TwinFault
from .overview import OverviewTwin
from .pictures import CameraTwin
from .stage import StageTwin


class SerialTwin(Protocol):
    """A device at a serial line."""

    def receive(self, data: bytes) -> bytes:
        """Take bytes from the line and return what the device answers at once."""


class Terminal:
    """A pseudo-terminal that passes bytes to a twin; use it in `with`.

    Attributes:
        port: the device file that a driver opens: a link of this terminal's own, since the number of a pseudo-terminal
            that was closed is soon another program's.
    """

    def __init__(self, twin: SerialTwin) -> None:
        """Open the terminal and begin to listen."""
        self._twin = twin
        self._controller, self._line = os.openpty()
        tty.setraw(self._line)
        self._folder = TemporaryDirectory(prefix="vitac-twin-")
        link = Path(self._folder.name) / "port"
        link.symlink_to(os.ttyname(self._line))
        self.port = str(link)
        self._wake_read, self._wake_write = os.pipe()
        self._thread = Thread(target=self._listen, name=f"twin at {self.port}", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Close the line, as when a USB cable is pulled; the driver's next call fails."""
        if self._thread.is_alive():
            os.write(self._wake_write, b"x")
            self._thread.join()
            self._folder.cleanup()
            for descriptor in (self._controller, self._line, self._wake_read, self._wake_write):
                os.close(descriptor)

    def _listen(self) -> None:
        while True:
            ready = wait([self._controller, self._wake_read])
            if self._wake_read in ready:
                return
            answer = self._twin.receive(os.read(self._controller, 4096))
            if answer:
                os.write(self._controller, answer)


_PICTURES: Final = 3
_LIMITS: Final[dict[str, Any]] = {
    "workspace": {"x_mm": [-15, 15], "y_mm": [-15, 15], "z_mm": [-30, 30], "rotation_deg": [-20, 20]},
    "speed_mm_s": 3,
    "rotation_deg_s": 4,
    "force_n": 20,
    "torque_nm": 1,
    "gripper": {"force": 100},
}
_PLAYING_LIMITS: Final[dict[str, Any]] = {
    "workspace": {"x_mm": [-60, 15], "y_mm": [-15, 15], "z_mm": [-48, 0], "rotation_deg": [-20, 20]},
    "speed_mm_s": 5,
    "force_n": 60,
    "torque_nm": 12,
    "reading_s": 30.0,
    "heartbeat_s": 90.0,
}
"""The torque is that of the largest force at the lower end of the peg, 0.19 m below the sensor."""
_PATIENCE: Final = 10.0
"""As with `reading_s` and `heartbeat_s`: its process shares cores with the station, and with whatever else runs."""
_FRAMES_HZ: Final = 250
"""Of forces, which change only with the pictures here."""
_OVERVIEW_PERIOD_S: Final = 0.1
_PROMPTS: Final = {"peg": [346, 290], "base": [342, 225]}


@dataclass
class TwinStation:
    """Twins at their lines.

    Attributes:
        lines: the serial ones, by device.
        description: what the station's file says of them.
    """

    left: CameraTwin
    right: CameraTwin
    force_torque: ForceTorqueTwin
    stage: StageTwin
    gripper: GripperTwin
    lines: dict[str, Terminal]
    description: dict[str, Any]

    def write(self, file: Path) -> None:
        """Write the station's file."""
        file.write_text(yaml.safe_dump(self.description, sort_keys=False), encoding="utf-8")


@contextmanager
def twin_station(*, picture_period_s: float = 0.04) -> Iterator[TwinStation]:
    """Start twins whose gels are at rest; they end with the context."""
    with ExitStack() as stack:
        left, right = (stack.enter_context(_camera(picture_period_s)) for _ in range(2))
        box = stack.enter_context(ForceTorqueTwin())
        yield _at_lines(stack, left, right, box, StageTwin(), GripperTwin())


@contextmanager
def playing_station(bench: Bench) -> Iterator[TwinStation]:
    """Start twins that behave by the physics of a bench; they end with the context."""
    with ExitStack() as stack:
        left, right = (stack.enter_context(camera) for camera in bench.cameras)
        box = stack.enter_context(bench.box)
        stack.enter_context(bench)
        station = _at_lines(stack, left, right, box, bench.stage, bench.gripper)
        station.description["limits"] |= _PLAYING_LIMITS
        station.description["patience"] = _PATIENCE
        station.description["force_torque"]["rate_hz"] = _FRAMES_HZ
        station.description["twin"] = bench.mark.model_dump(mode="json")
        station.description["procedure"] = {
            "task": str(bench.mounted.task),
            "shape": str(bench.mounted.shape),
            "hole": _describe_place(HOLE),
            "garage": _describe_place(bench.mounted.garage),
            "safe_z_mm": -20.0,
            "picture_s": bench.period_s,
            "release": "automatic",
            "latency_s": 0.12 + 2 * bench.period_s,
        }
        if bench.mounted.task is StationTask.LOCK:
            station.description["limits"]["workspace"] |= {"x_mm": [-10, 85]}
        _add_overview(station, bench, stack)
        if bench.depth_camera is not None:
            _add_depth_camera(station.description, stack.enter_context(bench.depth_camera))
        yield station


def _add_overview(station: TwinStation, bench: Bench, stack: ExitStack) -> None:
    code = Path(stack.enter_context(TemporaryDirectory(prefix="vitac-twin-"))) / "code.png"
    view = OverviewTwin(bench.stage, bench.part_at, bench.mounted, code)
    camera = stack.enter_context(CameraTwin(picture=view, period_s=_OVERVIEW_PERIOD_S))
    station.description["overview"] = {
        "serial_number": "OVERVIEW-1",
        "stream": camera.stream,
        "code_picture": str(code),
    }


def _add_depth_camera(description: dict[str, Any], camera: DepthCameraTwin) -> None:
    """Describe the camera, where its prompts are, and a workspace over both holes."""
    fx, fy, cx, cy = COLOUR_INTRINSICS
    intrinsics = {"width": WIDTH_PX, "height": HEIGHT_PX, "fx": fx, "fy": fy, "cx": cx, "cy": cy}
    known = {"serial_number": "D415-1", "firmware": "5.13.0.50"}
    camera.about = {**known, "intrinsics": intrinsics, "units_per_m": UNITS_PER_M}
    calibration = {"serial_number": known["serial_number"], **intrinsics}
    description["depth_camera"] = {**known, "stream": camera.stream, "calibration": calibration}
    description["procedure"]["prompts"] = _PROMPTS
    description["limits"]["workspace"] |= {"y_mm": [-35, 80], "z_mm": [-50, 0]}


def _at_lines(
    stack: ExitStack,
    left: CameraTwin,
    right: CameraTwin,
    box: ForceTorqueTwin,
    stage: StageTwin,
    gripper: GripperTwin,
) -> TwinStation:
    lines = {"stage": stack.enter_context(Terminal(stage)), "gripper": stack.enter_context(Terminal(gripper))}
    described = {
        "name": "twin",
        "left": _describe_camera("28F0-GX7F", left),
        "right": _describe_camera("28W2-TRN5", right),
        "force_torque": _describe_force_torque("FT-1", box),
        "stage": _describe_stage(lines["stage"], stage),
        "gripper": {"port": lines["gripper"].port},
        "limits": deepcopy(_LIMITS),
    }
    return TwinStation(left, right, box, stage, gripper, lines, described)


@cache
def _gel_pictures() -> list[NDArray[np.uint8]]:
    generator = np.random.default_rng(1)
    return [SMALL_CAMERA.picture(marker_grid(), generator) for _ in range(_PICTURES)]


def _camera(period_s: float) -> CameraTwin:
    pictures = cycle(_gel_pictures())
    return CameraTwin(picture=lambda: next(pictures), period_s=period_s)


def _describe_camera(serial_number: str, camera: CameraTwin) -> dict[str, Any]:
    calibration = {"serial_number": serial_number, "markers": len(marker_grid())}
    return {"serial_number": serial_number, "stream": camera.stream, "calibration": calibration}


def _describe_place(axes: tuple[float, float, float, float]) -> dict[str, float]:
    return dict(zip(("x_mm", "y_mm", "z_mm", "rotation_deg"), axes, strict=True))


def _describe_force_torque(serial_number: str, box: ForceTorqueTwin) -> dict[str, Any]:
    calibration = {"serial_number": serial_number, "decoupling": [list(row) for row in box.decoupling]}
    return {"host": "127.0.0.1", "port": box.port, "serial_number": serial_number, "calibration": calibration}


def _describe_stage(line: Terminal, stage: StageTwin) -> dict[str, Any]:
    steps = [stage.settings[number] for number in range(100, 104)]
    return {
        "port": line.port,
        "serial_number": stage.serial_number,
        "firmware": stage.firmware,
        "calibration": {"serial_number": stage.serial_number, "steps": steps},
    }


@dataclass(frozen=True)
class RunningTwin:
    """A twin in a process.

    Attributes:
        description: what a station's file says of it.
    """

    description: dict[str, Any]
    _line: Connection

    def begin(self, fault: TwinFault, for_s: float) -> None:
        """Break something for a while, by the twin's clock."""
        self._line.send((fault, for_s))
        self._line.recv()

    def is_whole(self) -> bool:
        """Say whether nothing is broken."""
        return self._ask()[0]

    def time_s(self) -> float:
        """Return the twin's time."""
        return self._ask()[1]

    def begun(self) -> tuple[TwinFault, ...]:
        """Return what has been broken so far."""
        return self._ask()[2]

    def _ask(self) -> tuple[bool, float, tuple[TwinFault, ...]]:
        self._line.send(None)
        is_whole, now_s, begun = self._line.recv()
        return is_whole, now_s, begun


@contextmanager
def twin_process(
    hidden: HiddenSettings,
    *,
    mounted: Mounted = CUBOID_PEG,
    script: FaultScript | None = None,
    period_s: float = 0.1,
    mark: TwinMark = PUBLIC_TWIN.mark,
) -> Iterator[RunningTwin]:
    """Start a twin that runs as fast as it can."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    arguments = (theirs, hidden, mounted, script or FaultScript(), period_s, mark)
    process = context.Process(target=_run, args=arguments, daemon=True)
    process.start()
    theirs.close()
    try:
        yield RunningTwin(ours.recv(), ours)
    finally:
        ours.close()
        process.join()


def _run(
    caller: Connection,
    hidden: HiddenSettings,
    mounted: Mounted,
    script: FaultScript,
    period_s: float,
    mark: TwinMark,
) -> None:
    """Run until the caller closes its end of the pipe or dies."""
    import cv2

    cv2.setNumThreads(1)
    bench = Bench(hidden=hidden, mounted=mounted, script=script, period_s=period_s, speed=None, mark=mark)
    with playing_station(bench) as station:
        caller.send(station.description)
        while True:
            try:
                asked = caller.recv()
            except EOFError:
                return
            if asked is not None:
                bench.begin(*asked)
            caller.send((bench.is_whole, bench.now_s, tuple(bench.begun)))
