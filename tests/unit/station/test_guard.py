"""The guard over twins at real lines: commands pass only within the limits, and a reading past one stops the stage."""

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from math import ceil

import numpy as np
import pytest
from vitac.evaluator.strict_model import validate
from vitac.station.description import StationDescription
from vitac.station.devices.force_torque import ForceTorqueSensor
from vitac.station.devices.gripper import HandE
from vitac.station.devices.stage import DeviceFault, GrblState, LinearStage, Pose
from vitac.station.guard import Guard, LimitPassed, StationStopped
from vitac.station.twin.force_torque import ForceTorqueFault
from vitac.station.twin.laboratory import TwinStation

TARGET = Pose(14.0, 0.0, 0.0, 10.0)
SLOW = {"speed_mm_s": 3.0, "rotation_deg_s": 4.0}


class Heartbeats:
    """Time by which heartbeats are counted, set by a test."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def heartbeats() -> Heartbeats:
    return Heartbeats()


@pytest.fixture
def guard(twins: TwinStation, heartbeats: Heartbeats) -> Iterator[Guard]:
    limits = validate(StationDescription, twins.description, "station.yaml").limits
    with ExitStack() as stack:
        stage = stack.enter_context(LinearStage(twins.lines["stage"].port))
        gripper = stack.enter_context(HandE(twins.lines["gripper"].port))
        force_torque = stack.enter_context(ForceTorqueSensor("127.0.0.1", twins.force_torque.port))
        gripper.activate()
        force_torque.start(rate_hz=1000)
        yield stack.enter_context(
            Guard(limits=limits, stage=stage, gripper=gripper, force_torque=force_torque, clock=heartbeats)
        )


def sense(twins: TwinStation, *wrench: float) -> None:
    x, y, z, a, b, c = wrench
    twins.force_torque.wrench = lambda: (x, y, z, a, b, c)


def assert_held(guard: Guard, twins: TwinStation, reason: str) -> None:
    """The stage comes to rest far from its target, and no command moves it."""
    with pytest.raises(StationStopped, match=reason):
        guard.wait()
    while guard.stage.status().is_moving:
        pass
    assert guard.stage.status().state is GrblState.HOLD
    held = twins.stage.position()
    assert held[0] < TARGET.x_mm / 2
    with pytest.raises(StationStopped, match="Make it safe, then release it"):
        guard.move(TARGET, **SLOW)
    with pytest.raises(StationStopped):
        guard.grip(100, speed=10, force=10)
    assert twins.stage.position() == held


def test_moves_within_the_limits(guard: Guard) -> None:
    target = Pose(0.02, -0.01, 0.01, 0.03)
    guard.move(target, **SLOW)
    assert guard.wait().pose == target


@pytest.mark.parametrize("state", ["Hold:0", "Door:1"])
def test_motion_that_never_ends_is_a_fault_after_its_time(
    guard: Guard, twins: TwinStation, monkeypatch: pytest.MonkeyPatch, state: str
) -> None:
    """As when somebody presses a button of the stage's controller: it neither arrives nor reports an alarm."""
    guard.move(TARGET, **SLOW)
    monkeypatch.setattr(twins.stage, "_report", lambda: f"<{state}|MPos:1.000,0.000,0.000,0.000|FS:0,0>\r\n")
    for _ in range(ceil((3 * TARGET.x_mm / 3.0 + 10.0) / guard.picture_s)):
        guard.check_motion()
        guard.beat()
    guard.beat()
    with pytest.raises(DeviceFault, match=r"should have been at rest 10 s ago\. Look what holds it"):
        guard.wait()
    with pytest.raises(StationStopped, match="Look what holds it"):
        guard.wait()


@pytest.mark.parametrize(
    ("target", "sentence"),
    [
        (TARGET._replace(x_mm=15.1), r"Target x_mm 15\.1: expected -15\.0 to 15\.0"),
        (TARGET._replace(rotation_deg=-21.0), "Target rotation_deg"),
        (TARGET._replace(z_mm=float("nan")), "Target z_mm nan"),
    ],
)
def test_target_past_the_workspace_is_not_sent(guard: Guard, twins: TwinStation, target: Pose, sentence: str) -> None:
    with pytest.raises(LimitPassed, match=sentence):
        guard.move(target, **SLOW)
    assert twins.stage.position() == (0, 0, 0, 0)
    assert guard.reason is None


@pytest.mark.parametrize("speed", [3.1, 0.0, -1.0, float("nan")])
def test_speed_past_its_limit_is_not_sent(guard: Guard, twins: TwinStation, speed: float) -> None:
    with pytest.raises(LimitPassed, match=r"speed_mm_s \S+: expected more than 0 and at most 3"):
        guard.move(TARGET, speed_mm_s=speed, rotation_deg_s=4.0)
    assert twins.stage.speed() == 0


def test_grip_past_its_limit_is_not_sent(guard: Guard, twins: TwinStation) -> None:
    with pytest.raises(LimitPassed, match="Gripper force 101: expected 0 to 100"):
        guard.grip(255, speed=255, force=101)
    assert guard.gripper.status().request == 0
    guard.grip(255, speed=255, force=100)
    assert guard.gripper.wait(timeout_s=5.0).position == 180


def test_what_is_measured_has_nothing_of_what_was_felt_before(guard: Guard, twins: TwinStation) -> None:
    guard.measure_wrench(frames=100)  # at rest
    sense(twins, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0)
    guard.measure_wrench(frames=2)  # one may have been on its way
    assert guard.measure_wrench(frames=3).force_z_n == pytest.approx(4.0)
    wrench = guard.wrench()
    assert wrench is not None
    assert wrench.force_z_n < 3.9


@pytest.mark.parametrize(
    ("wrench", "reason"),
    [
        ((0, 12, 16.1, 0, 0, 0), r"Force 20\.08 N: expected at most 20"),
        ((0, 0, 0, 0, 0, -1.1), r"Torque 1\.100 N m: expected at most 1"),
        ((float("nan"), 0, 0, 0, 0, 0), "Force nan N"),
    ],
)
def test_force_past_its_limit_stops_the_stage(
    guard: Guard, twins: TwinStation, wrench: tuple[float, ...], reason: str
) -> None:
    guard.move(TARGET, **SLOW)
    sense(twins, *wrench)
    assert_held(guard, twins, reason)


def test_marker_past_its_limit_stops_the_stage(guard: Guard, twins: TwinStation) -> None:
    guard.move(TARGET, **SLOW)
    guard.see_markers(np.array([[0.0, 1.0], [29.0, 0.0]]))
    assert guard.reason is None
    guard.see_markers(np.array([[0.0, 1.0], [25.0, 17.0]]))
    assert_held(guard, twins, r"A marker moved by 30\.2 px: expected at most 30")


def test_lost_heartbeat_stops_the_stage(guard: Guard, twins: TwinStation, heartbeats: Heartbeats) -> None:
    guard.move(TARGET, **SLOW)
    heartbeats.now_s = 0.4
    guard.beat()
    heartbeats.now_s = 0.8
    assert guard.stage.status().is_moving
    assert guard.reason is None
    heartbeats.now_s = 1.0
    assert_held(guard, twins, r"No heartbeat for 0\.60 s: expected one every 0\.5 s")


def freeze(twins: TwinStation) -> None:
    twins.force_torque.faults.add(ForceTorqueFault.FROZEN)


def cut(twins: TwinStation) -> None:
    twins.force_torque.cut()


@pytest.mark.parametrize("fail", [freeze, cut])
def test_stage_stops_when_the_force_is_no_longer_known(
    guard: Guard, twins: TwinStation, fail: Callable[[TwinStation], None]
) -> None:
    guard.move(TARGET, **SLOW)
    guard.limits = guard.limits.model_copy(update={"reading_s": 0.05})
    sent = twins.force_torque.sent
    while twins.force_torque.sent < sent + 3:  # the guard waits by the new limit once the next frame is there
        pass
    fail(twins)
    assert_held(guard, twins, "force/torque box")


def test_motion_that_reaches_the_controller_after_a_stop_is_held(
    guard: Guard, twins: TwinStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = guard.stage.start_move

    def stopped_before(target: Pose, *, feed: float) -> None:
        guard.stop("an operator pressed stop.")  # its hold finds the stage at rest, and does nothing
        start(target, feed=feed)

    monkeypatch.setattr(guard.stage, "start_move", stopped_before)
    with pytest.raises(StationStopped, match="an operator pressed stop"):
        guard.move(TARGET, **SLOW)
    assert_held(guard, twins, "an operator pressed stop")


def test_zero_that_has_drifted_is_taken_again_while_the_guard_watches(guard: Guard, twins: TwinStation) -> None:
    sense(twins, 0.0, 1.0, 5.0, 0.0, 0.0, 0.1)
    guard.measure_wrench()  # frames of before are on their way
    assert guard.measure_wrench() == pytest.approx((0.0, 1.0, 5.0, 0.0, 0.0, 0.1))
    guard.zero_forces()
    assert guard.measure_wrench() == pytest.approx((0.0,) * 6)
    sense(twins, 0.0, 1.0, 8.0, 0.0, 0.0, 0.1)
    guard.measure_wrench()
    assert guard.measure_wrench() == pytest.approx((0.0, 0.0, 3.0, 0.0, 0.0, 0.0))
    twins.force_torque.cut()
    with pytest.raises(StationStopped, match="force/torque box"):
        guard.zero_forces()


def test_released_station_moves_again_from_where_it_was_held(guard: Guard, twins: TwinStation) -> None:
    guard.move(TARGET, **SLOW)
    guard.stop("an operator pressed stop.")
    guard.release()
    assert guard.stage.status().state is GrblState.IDLE
    target = Pose(*(round(value, 2) for value in twins.stage.position()))
    guard.move(target, **SLOW)
    assert guard.wait().pose == target


def test_stage_in_motion_takes_no_other_target(guard: Guard) -> None:
    guard.move(TARGET, **SLOW)
    with pytest.raises(DeviceFault, match="Expected a stage at rest, got Run"):
        guard.move(TARGET._replace(x_mm=0.0), **SLOW)


def test_stage_does_not_move_on_when_nobody_guards_it(twins: TwinStation, guard: Guard) -> None:
    guard.move(TARGET, **SLOW)
    guard.__exit__()
    assert_held(guard, twins, "Nobody guards it")


KILLED = """
import os, signal, sys
from vitac.station.devices.stage import LinearStage, Pose
with LinearStage(sys.argv[1]) as stage, stage.held_if_killed():
    stage.start_move(Pose(14.0, 0.0, 0.0, 0.0), feed=180.0)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_stage_is_held_when_the_process_that_commands_it_is_killed(twins: TwinStation) -> None:
    line = twins.lines["stage"].port
    assert subprocess.run([sys.executable, "-c", KILLED, line], check=False).returncode == -signal.SIGKILL
    with LinearStage(line) as stage:
        while stage.status().is_moving:
            pass
        assert stage.status().state is GrblState.HOLD
    assert twins.stage.position()[0] < TARGET.x_mm / 2
    with LinearStage(line) as stage, stage.held_if_killed():
        stage.forget_motion()
    with LinearStage(line) as stage:
        assert stage.status().state is GrblState.IDLE
