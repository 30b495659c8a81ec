"""The driver of the stage against its twin, over a real pseudo-terminal."""

import itertools
from collections.abc import Iterator
from threading import Event

import pytest
from vitac.station.devices.stage import (
    DeviceFault,
    DeviceNotFound,
    GrblState,
    Identity,
    LinearStage,
    Pose,
    StageSilent,
    StageStatus,
)
from vitac.station.twin.laboratory import Terminal
from vitac.station.twin.stage import StageFault, StageTwin

TARGET = Pose(10.0, -5.0, 2.5, 15.0)


class Clock:
    """Time that a test sets."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def twin(clock: Clock) -> StageTwin:
    return StageTwin(clock=clock)


@pytest.fixture
def line(twin: StageTwin) -> Iterator[Terminal]:
    with Terminal(twin) as terminal:
        yield terminal


@pytest.fixture
def stage(line: Terminal) -> Iterator[LinearStage]:
    with LinearStage(line.port) as opened:
        yield opened


def test_says_who_it_is_and_how_it_is_set(stage: LinearStage) -> None:
    assert stage.identify() == Identity(serial_number="STAGE-1", firmware="1.1h.20190825")
    assert stage.settings()[120] == 500.0


def test_moves_to_a_pose_and_rests_there(stage: LinearStage, clock: Clock) -> None:
    stage.start_move(TARGET, feed=600.0)
    clock.now_s = 0.5
    status = stage.status()
    assert (status.state, status.is_moving) == (GrblState.RUN, True)
    assert 0 < status.pose.x_mm < TARGET.x_mm
    clock.now_s = 10.0
    status = stage.status()
    assert (status.state, status.is_moving, status.pose) == (GrblState.IDLE, False, TARGET)


def test_hold_brakes_with_the_acceleration_of_the_stage(stage: LinearStage, twin: StageTwin, clock: Clock) -> None:
    stage.start_move(TARGET, feed=600.0)
    clock.now_s = 0.5
    stage.hold()
    assert stage.status().is_moving
    assert twin.speed() == 10.0
    clock.now_s = 0.5 + 10.0 / 500.0
    status = stage.status()
    assert (status.state, status.is_moving) == (GrblState.HOLD, False)
    assert twin.rest_s == clock.now_s


def test_position_is_known_after_a_held_motion_is_forgotten(stage: LinearStage, clock: Clock) -> None:
    stage.start_move(TARGET, feed=600.0)
    clock.now_s = 0.5
    stage.hold()
    assert stage.status().is_moving
    clock.now_s = 1.0
    held = stage.status().pose
    stage.forget_motion()
    assert stage.status().state is GrblState.IDLE
    assert stage.status().pose == held


def test_reset_in_motion_loses_the_position_and_homing_finds_it(stage: LinearStage, clock: Clock) -> None:
    stage.start_move(TARGET, feed=600.0)
    clock.now_s = 0.5
    stage.forget_motion()
    assert stage.status().state is GrblState.ALARM
    with pytest.raises(DeviceFault, match=r"error:9\. It is locked by an alarm: clear its way, then home it"):
        stage.start_move(TARGET, feed=600.0)
    stage.home()
    assert stage.status().pose == Pose(0, 0, 0, 0)


def test_unlocked_stage_stands_where_its_alarm_stopped_it(stage: LinearStage, twin: StageTwin, clock: Clock) -> None:
    stage.start_move(TARGET, feed=600.0)
    clock.now_s = 100.0
    twin.faults.add(StageFault.ALARM)
    with pytest.raises(DeviceFault, match="ALARM:1"):
        stage.start_move(Pose(0, 0, 0, 0), feed=600.0)
    twin.faults.clear()
    stage.unlock()
    assert stage.status() == StageStatus(state=GrblState.IDLE, is_moving=False, pose=TARGET)


def test_limit_switch_is_a_fault_with_its_remedy(stage: LinearStage, twin: StageTwin) -> None:
    twin.faults.add(StageFault.ALARM)
    with pytest.raises(DeviceFault, match=r"ALARM:1\. It met a limit switch"):
        stage.start_move(TARGET, feed=600.0)
    stage.home()
    assert stage.status() == StageStatus(state=GrblState.IDLE, is_moving=False, pose=Pose(0, 0, 0, 0))


def test_limit_switch_in_a_motion_is_named_and_the_locked_controller_is_opened_again(
    stage: LinearStage, twin: StageTwin, line: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GRBL says so once and then answers nothing, not even `?`, until it is reset."""
    monkeypatch.setattr("vitac.station.devices.stage._ANSWER_S", 0.05)
    twin.faults.add(StageFault.ALARM)
    stage._line.write(b"G1 X1 F100\n")
    with pytest.raises(DeviceFault, match=r"went into alarm, ALARM:1\. It met a limit switch and lost its position"):
        stage.status()
    with pytest.raises(DeviceFault, match="did not answer"):
        stage.status()
    stage.__exit__()
    with LinearStage(line.port) as again:
        assert again.status().state is GrblState.ALARM
        again.home()
        assert again.status().state is GrblState.IDLE


def test_target_beyond_the_travel_is_refused_by_the_controller(stage: LinearStage) -> None:
    with pytest.raises(DeviceFault, match=r"ALARM:2\. The target is beyond its travel"):
        stage.start_move(TARGET._replace(x_mm=1000.0), feed=600.0)


def test_silent_controller_is_a_fault(stage: LinearStage, twin: StageTwin, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.station.devices.stage._ANSWER_S", 0.05)
    twin.faults.add(StageFault.SILENT)
    with pytest.raises(DeviceFault, match=r"did not answer within 0\.05 s"):
        stage.status()


def test_slow_controller_is_waited_for_with_patience_alone(
    line: Terminal, twin: StageTwin, monkeypatch: pytest.MonkeyPatch
) -> None:
    receive, core = twin.receive, Event()

    def receive_late(data: bytes) -> bytes:
        core.wait(0.3)  # for a core of a busy machine
        return receive(data)

    with LinearStage(line.port) as hasty:
        monkeypatch.setattr("vitac.station.devices.stage._ANSWER_S", 0.1)
        monkeypatch.setattr(twin, "receive", receive_late)
        with pytest.raises(StageSilent):
            hasty.status()
        core.set()
    with LinearStage(line.port, patience=100.0) as patient:
        core.clear()
        assert patient.status().state is GrblState.IDLE


def test_answer_that_waits_for_this_process_is_not_late(stage: LinearStage, monkeypatch: pytest.MonkeyPatch) -> None:
    times_s = itertools.chain([0.0], itertools.repeat(10.0))  # this process waited for a core for ten seconds

    def wait_for_a_core() -> float:
        while not stage._line.in_waiting:
            Event().wait(1e-3)
        return next(times_s)

    monkeypatch.setattr("vitac.station.devices.stage.monotonic", wait_for_a_core)
    assert stage.status().state is GrblState.IDLE


def test_three_axes_are_too_few(stage: LinearStage, twin: StageTwin, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin, "receive", lambda _: b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n")
    with pytest.raises(DeviceFault, match="Expected MPos of four axes"):
        stage.status()


def test_unplugged_line_is_a_fault(stage: LinearStage, line: Terminal) -> None:
    line.unplug()
    with pytest.raises(DeviceFault, match=r"The line to the stage at \S+ broke"):
        stage.status()


def test_port_at_which_nothing_answers_has_no_stage(
    line: Terminal, twin: StageTwin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vitac.station.devices.stage._ANSWER_S", 0.05)
    twin.faults.add(StageFault.SILENT)
    with pytest.raises(DeviceNotFound, match=r"Nothing answers at \S+: expected GRBL 1\.1"):
        LinearStage(line.port)


def test_stage_that_restarts_when_its_port_is_opened_is_waited_for(
    line: Terminal, twin: StageTwin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vitac.station.devices.stage._ANSWER_S", 0.05)
    answers = [b"", b"\r\nGrbl 1.1h ['$' for help]\r\n<Idle|MPos:0.000,0.000,0.000,0.000|FS:0,0>\r\n"]
    receive = twin.receive
    monkeypatch.setattr(twin, "receive", lambda data: answers.pop(0) if answers else receive(data))
    with LinearStage(line.port) as stage:
        assert stage.identify().firmware == "1.1h.20190825"


def test_missing_port_is_named() -> None:
    with pytest.raises(DeviceNotFound, match="No stage at /dev/no-such-port"):
        LinearStage("/dev/no-such-port")
