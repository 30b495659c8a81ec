"""Measures how long a stage moves after a force has passed its limit, from the bytes on the lines.

    .venv/bin/python benchmarks/station/stop.py [--stops 300]

Driver, guard and limits are the station's; the twins note when the frame with the force leaves the force/torque box,
when the hold arrives at the stage, and when the stage is at rest, braking at 500 mm/s^2 from 3 mm/s.
"""

import argparse
from contextlib import ExitStack
from time import monotonic, sleep

import numpy as np
from vitac.station.description import GripperLimits, Limits, Workspace
from vitac.station.devices.force_torque import ForceTorqueSensor
from vitac.station.devices.gripper import Gripper
from vitac.station.devices.stage import Pose, Stage
from vitac.station.guard import Guard, StationStopped
from vitac.station.limits import CONTROL_PERIOD_S
from vitac.station.twin.force_torque import ForceTorqueTwin, Values
from vitac.station.twin.gripper import GripperTwin
from vitac.station.twin.stage import StageTwin
from vitac.station.twin.terminal import Terminal

SPEED_MM_S = 3.0
FAR_MM = 14.0
LIMITS = Limits(
    workspace=Workspace(x_mm=(-15, 15), y_mm=(-15, 15), z_mm=(-30, 30), rotation_deg=(-20, 20)),
    speed_mm_s=SPEED_MM_S,
    rotation_deg_s=4,
    force_n=20,
    torque_nm=1,
    reading_s=1,
    heartbeat_s=3600,
    gripper=GripperLimits(force=100),
)


class Spike:
    """A force that passes its limit from a time on, and the time at which the first such frame was sent."""

    def __init__(self) -> None:
        self.due_s = float("inf")
        self.sent_s: float | None = None

    def __call__(self) -> Values:
        """Return the force of the frame that is sent now."""
        if monotonic() < self.due_s:
            return 0.0, 0.0, 5.0, 0.0, 0.0, 0.0
        self.sent_s = self.sent_s or monotonic()
        return 0.0, 0.0, 30.0, 0.0, 0.0, 0.0


def measure(guard: Guard, stage: StageTwin, spike: Spike, generator: np.random.Generator) -> tuple[float, float]:
    """Stop one motion; return the times from the frame to the hold and to rest [s]."""
    side = -1.0 if stage.position()[0] > 0 else 1.0
    guard.move(Pose(side * FAR_MM, 0, 0, 0), speed_mm_s=SPEED_MM_S, rotation_deg_s=4)
    spike.sent_s, spike.due_s = None, monotonic() + generator.uniform(0.03, 0.08)
    try:
        guard.wait()
    except StationStopped:
        while guard.stage.status().is_moving:
            continue
    assert spike.sent_s is not None, guard.reason  # noqa: S101
    assert stage.held_s is not None  # noqa: S101
    assert stage.rest_s is not None  # noqa: S101
    times = stage.held_s - spike.sent_s, stage.rest_s - spike.sent_s
    spike.due_s = float("inf")
    sleep(0.02)  # the frames with the force are read
    guard.release()
    return times


def main() -> None:
    """Print the distribution of both times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stops", type=int, default=300)
    stops = parser.parse_args().stops
    generator, spike, stage_twin = np.random.default_rng(1), Spike(), StageTwin()
    with ExitStack() as stack:
        box = stack.enter_context(ForceTorqueTwin(wrench=spike))
        stage = stack.enter_context(Stage(stack.enter_context(Terminal(stage_twin)).port))
        gripper = stack.enter_context(Gripper(stack.enter_context(Terminal(GripperTwin())).port))
        sensor = stack.enter_context(ForceTorqueSensor("127.0.0.1", box.port))
        sensor.start(rate_hz=1000)
        guard = stack.enter_context(Guard(limits=LIMITS, stage=stage, gripper=gripper, force_torque=sensor))
        measured_ms = 1e3 * np.array([measure(guard, stage_twin, spike, generator) for _ in range(stops)])
    for name, times_ms in zip(("hold arrives", "at rest"), measured_ms.T, strict=True):
        median, high, largest = np.percentile(times_ms, (50, 99, 100))
        print(f"{name:<13} median {median:.2f} ms, p99 {high:.2f} ms, largest {largest:.2f} ms of {stops}")
    within = (measured_ms[:, 1] <= 1e3 * CONTROL_PERIOD_S).mean()
    print(f"at rest within one control period of {1e3 * CONTROL_PERIOD_S:.0f} ms: {within:.1%}")


if __name__ == "__main__":
    main()
