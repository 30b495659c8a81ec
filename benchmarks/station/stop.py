"""Measures how long a stage moves after a force has passed its limit, from the bytes on the lines.

    .venv/bin/python benchmarks/station/stop.py [--stops 300]

Driver, guard and limits are the station's. The twins run in a process of their own, as devices do, and note when the
frame with the force leaves the force/torque box, when the hold arrives at the stage, and when the stage is at rest:
it brakes at 500 mm/s^2 from 3 mm/s, in 6 ms. Exit code 1 if a stop takes longer than a control period.
"""

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from time import monotonic, sleep

import numpy as np
from vitac.station.description import GripperLimits, StageWorkspace, StationLimits
from vitac.station.devices.force_torque import ForceTorqueSensor
from vitac.station.devices.gripper import HandE
from vitac.station.devices.stage import LinearStage, Pose
from vitac.station.guard import CONTROL_PERIOD_S, Guard, StationStopped
from vitac.station.twin.force_torque import ForceTorqueTwin, Values
from vitac.station.twin.gripper import GripperTwin
from vitac.station.twin.laboratory import Terminal
from vitac.station.twin.stage import StageTwin

SPEED_MM_S, ROTATION_DEG_S = 3.0, 4.0
FAR_MM = 14.0
LIMITS = StationLimits(
    workspace=StageWorkspace(x_mm=(-15, 15), y_mm=(-15, 15), z_mm=(-30, 30), rotation_deg=(-20, 20)),
    speed_mm_s=SPEED_MM_S,
    rotation_deg_s=ROTATION_DEG_S,
    force_n=20,
    torque_nm=1,
    reading_s=1,
    heartbeat_s=3600,
    gripper=GripperLimits(force=100),
)


@dataclass
class Spike:
    """A force that passes its limit from a time on, and when the first such frame was sent."""

    due_s: float = float("inf")
    sent_s: float | None = None

    def wrench(self) -> Values:
        """Return the force of the frame that is sent now."""
        if monotonic() < self.due_s:
            return 0.0, 0.0, 5.0, 0.0, 0.0, 0.0
        self.sent_s = self.sent_s or monotonic()
        return 0.0, 0.0, 30.0, 0.0, 0.0, 0.0


def run_twins(caller: Connection) -> None:
    """Send where the twins are; then take the time of a spike, or None to end it and send when what happened."""
    spike, stage = Spike(), StageTwin()
    with ForceTorqueTwin(wrench=spike.wrench) as box, Terminal(stage) as line, Terminal(GripperTwin()) as fingers:
        caller.send((box.port, line.port, fingers.port))
        while (due_s := caller.recv()) != 0.0:
            if due_s is None:
                caller.send((spike.sent_s, stage.held_s, stage.rest_s))
                spike.due_s = float("inf")
            else:
                spike.sent_s, spike.due_s = None, due_s


@contextmanager
def twin_process() -> Iterator[tuple[Connection, Guard]]:
    """Start the twins and a guard over them."""
    ours, theirs = get_context("spawn").Pipe()
    process = get_context("spawn").Process(target=run_twins, args=(theirs,))
    process.start()
    box, line, fingers = ours.recv()
    with ExitStack() as stack:
        stage, gripper = stack.enter_context(LinearStage(line)), stack.enter_context(HandE(fingers))
        sensor = stack.enter_context(ForceTorqueSensor("127.0.0.1", box))
        sensor.start(rate_hz=1000)
        yield ours, stack.enter_context(Guard(limits=LIMITS, stage=stage, gripper=gripper, force_torque=sensor))
    ours.send(0.0)
    process.join()


def measure(guard: Guard, twins: Connection, generator: np.random.Generator) -> tuple[float, float]:
    """Stop one motion; return the times from the frame to the hold and to rest [s]."""
    side = -1.0 if guard.stage.status().pose.x_mm > 0 else 1.0
    guard.move(Pose(side * FAR_MM, 0, 0, 0), speed_mm_s=SPEED_MM_S, rotation_deg_s=ROTATION_DEG_S)
    twins.send(monotonic() + generator.uniform(0.03, 0.08))
    try:
        guard.wait()
    except StationStopped:
        while guard.stage.status().is_moving:
            continue
    twins.send(None)
    sent_s, held_s, rest_s = twins.recv()
    sleep(0.02)  # the frames with the force are read
    guard.release()
    return held_s - sent_s, rest_s - sent_s


def main() -> int:
    """Print the distribution of both times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=300)
    stops, generator = parser.parse_args().stops, np.random.default_rng(1)
    with twin_process() as (twins, guard):
        measured_ms = 1e3 * np.array([measure(guard, twins, generator) for _ in range(stops)])
    for name, times_ms in zip(("hold arrives", "at rest"), measured_ms.T, strict=True):
        median, high, largest = np.percentile(times_ms, (50, 99, 100))
        print(f"{name:<13} median {median:.2f} ms, p99 {high:.2f} ms, largest {largest:.2f} ms of {stops}")
    within = (measured_ms[:, 1] <= 1e3 * CONTROL_PERIOD_S).mean()
    print(f"at rest within one control period of {1e3 * CONTROL_PERIOD_S:.0f} ms: {within:.1%}")
    return 0 if within == 1.0 else 1


if __name__ == "__main__":
    sys.exit(main())
