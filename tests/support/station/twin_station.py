"""A whole station of twins, each at its own line, and the file that describes it."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from vitac.station.twin.force_torque import ForceTorqueTwin
from vitac.station.twin.gripper import GripperTwin
from vitac.station.twin.pictures import CameraTwin
from vitac.station.twin.pressed_gel import SMALL_CAMERA, marker_grid
from vitac.station.twin.stage import StageTwin
from vitac.station.twin.terminal import Terminal


@cache
def gel_pictures() -> list[NDArray[np.uint8]]:
    """Pictures of a gel at rest, rendered once."""
    generator = np.random.default_rng(1)
    return [SMALL_CAMERA.picture(marker_grid(), generator) for _ in range(3)]


def camera() -> CameraTwin:
    pictures = cycle(gel_pictures())
    return CameraTwin(picture=lambda: next(pictures), period_s=0.001)


@dataclass
class TwinStation:
    """Twins of all devices but the RGB-D camera, and their description as YAML would give it."""

    left: CameraTwin
    right: CameraTwin
    force_torque: ForceTorqueTwin
    stage: StageTwin
    gripper: GripperTwin
    lines: dict[str, Terminal]
    description: dict[str, Any]

    def write(self, folder: Path) -> Path:
        file = folder / "station.yaml"
        file.write_text(yaml.safe_dump(self.description))
        return file


def tactile(serial_number: str, stream: str) -> dict[str, Any]:
    calibration = {"serial_number": serial_number, "markers": 63}
    return {"serial_number": serial_number, "stream": stream, "calibration": calibration}


@contextmanager
def twin_station() -> Iterator[TwinStation]:
    with ExitStack() as stack:
        left, right = stack.enter_context(camera()), stack.enter_context(camera())
        box = stack.enter_context(ForceTorqueTwin())
        stage, gripper = StageTwin(), GripperTwin()
        lines = {
            "stage": stack.enter_context(Terminal(stage)),
            "gripper": stack.enter_context(Terminal(gripper)),
        }
        description = {
            "name": "twin",
            "left": tactile("28F0-GX7F", left.stream),
            "right": tactile("28W2-TRN5", right.stream),
            "force_torque": {
                "host": "127.0.0.1",
                "port": box.port,
                "serial_number": "FT-1",
                "calibration": {"serial_number": "FT-1", "decoupling": [list(row) for row in box.decoupling]},
            },
            "stage": {
                "port": lines["stage"].port,
                "serial_number": "STAGE-1",
                "firmware": "1.1h.20190825",
                "calibration": {"serial_number": "STAGE-1", "steps": [400, 400, 400, 80]},
            },
            "gripper": {"port": lines["gripper"].port},
            "limits": {
                "workspace": {"x_mm": [-15, 15], "y_mm": [-15, 15], "z_mm": [-30, 30], "rotation_deg": [-20, 20]},
                "speed_mm_s": 3,
                "rotation_deg_s": 4,
                "force_n": 20,
                "torque_nm": 1,
                "gripper": {"force": 100},
                "reading_s": 5.0,
            },
        }
        yield TwinStation(left, right, box, stage, gripper, lines, description)
