"""One thread that looks, and all that listen to it; twins of cameras are elsewhere, these pictures a test places."""

from collections.abc import Iterator
from itertools import chain, repeat
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.station.description import Procedure, Release, StagePose, StationTask
from vitac.station.devices.stage import DeviceFault, GrblState, Pose
from vitac.station.eyes import Eyes, Finger, _free, _make_ready
from vitac.station.guard import StopCause
from vitac.station.perception.markers import DROPPED_PICTURES
from vitac.station.twin.gel_view import SMALL_CAMERA, marker_grid

Picture = np.ndarray


def picture(*, torn: bool = False, moved_px: float = 0.0) -> Picture:
    taken = SMALL_CAMERA.picture(marker_grid() + moved_px, np.random.default_rng(1))
    if torn:
        taken[100:220, 200:330] //= 5
    return taken


class Camera:
    """Sends pictures, then the last one again and again; or fails after them."""

    def __init__(self, *pictures: Picture, fails: bool = False) -> None:
        self.pictures: Iterator[Picture] = chain(pictures, () if fails else repeat(pictures[-1]))

    def read(self) -> Picture:
        for each in self.pictures:
            return each
        raise DeviceFault("The camera stopped sending.")


class Stage:
    """Stands somewhere, and notes where it was sent."""

    def __init__(self, at: Pose) -> None:
        self.way: list[Any] = [at]

    def status(self) -> SimpleNamespace:
        return SimpleNamespace(pose=self.way[-1], is_moving=False)

    def start_move(self, target: Pose, feed: float) -> None:
        assert feed == 180.0
        self.way.append(target)


class LockedStage(Stage):
    """In alarm until it is homed or unlocked."""

    state = GrblState.ALARM

    def status(self) -> SimpleNamespace:
        return SimpleNamespace(
            pose=self.way[-1] if self.way[-1] != "unlock" else self.way[-2], is_moving=False, state=self.state
        )

    def home(self) -> None:
        self.state = GrblState.IDLE
        self.way += ["home", Pose(0.0, 0.0, 0.0, 0.0)]

    def unlock(self) -> None:
        self.state = GrblState.IDLE
        self.way.append("unlock")


@pytest.mark.parametrize(
    ("task", "way"),
    [
        (StationTask.PEG, [(3.0, 1.0, -20.0, 2.0)]),
        (StationTask.LOCK, [(3.0, 1.0, -41.0, 2.0), (76.5, 0.0, -41.0, 2.0), (76.5, 0.0, -20.0, 2.0)]),
    ],
)
def test_what_a_killed_agent_left_pressed_onto_something_is_taken_away(
    task: StationTask, way: list[tuple[float, float, float, float]]
) -> None:
    hole, garage = StagePose(x_mm=0, y_mm=0, z_mm=-40), StagePose(x_mm=75, y_mm=0, z_mm=-40)
    procedure = Procedure(task=task, shape="any", hole=hole, garage=garage, safe_z_mm=-20, release=Release.AUTOMATIC)
    stage: Any = Stage(Pose(3.0, 1.0, -36.0, 2.0))
    description: Any = SimpleNamespace(limits=SimpleNamespace(speed_mm_s=3.0), patience=1.0)
    _free(stage, description, procedure, (1.5, -1.0))
    assert stage.way[1:] == way
    waits = procedure.model_copy(update={"release": Release.OPERATOR})
    _free(stage, description, waits, (1.5, -1.0))
    assert len(stage.way) == len(way) + 1


@pytest.mark.parametrize(
    ("task", "way"),
    [
        (StationTask.PEG, ["home", (0.0, 0.0, 0.0, 0.0)]),
        (
            StationTask.LOCK,
            [
                "unlock",
                (3.0, 1.0, -40.0, 2.0),
                (75.0, 0.0, -40.0, 2.0),
                (75.0, 0.0, -20.0, 2.0),
                "home",
                (0.0, 0.0, 0.0, 0.0),
            ],
        ),
    ],
)
def test_key_leaves_its_lock_before_a_stage_in_alarm_is_homed(task: StationTask, way: list[Any]) -> None:
    hole, garage = StagePose(x_mm=0, y_mm=0, z_mm=-40), StagePose(x_mm=75, y_mm=0, z_mm=-40)
    procedure = Procedure(task=task, shape="any", hole=hole, garage=garage, safe_z_mm=-20, release=Release.AUTOMATIC)
    force_torque = SimpleNamespace(rate_hz=100)
    description: Any = SimpleNamespace(
        limits=SimpleNamespace(speed_mm_s=3.0), patience=1.0, procedure=procedure, force_torque=force_torque
    )
    box: Any = SimpleNamespace(start=lambda _rate_hz: None)
    gripper: Any = SimpleNamespace(activate=lambda: None, status=lambda: SimpleNamespace(position=200))
    stage: Any = LockedStage(Pose(3.0, 1.0, -36.0, 2.0))
    _make_ready(stage, gripper, box, description, (0.0, 0.0))
    assert stage.way[1:] == way
    description.procedure = procedure.model_copy(update={"release": Release.OPERATOR})
    waiting: Any = LockedStage(Pose(3.0, 1.0, -36.0, 2.0))
    if task is StationTask.LOCK:
        with pytest.raises(DeviceFault, match="open the gripper by hand, and put the key into its garage"):
            _make_ready(waiting, gripper, box, description, (0.0, 0.0))
        assert len(waiting.way) == 1
    else:
        _make_ready(waiting, gripper, box, description, (0.0, 0.0))
        assert waiting.way[1] == "home"


class Guarded:
    """Notes why it was stopped."""

    def __init__(self) -> None:
        self.reasons, self.seen = list[str](), 0
        self.limits = SimpleNamespace(heartbeat_s=0.4)
        self.stop = lambda reason, *, cause: self.reasons.append(reason) if cause is StopCause.FAULT else None

    def beat(self) -> None:
        """It is alive."""

    def see_markers(self, _: np.ndarray) -> None:
        self.seen += 1


def eyes(left: Any, right: Any, guard: Any = None) -> Eyes:
    return Eyes(left=left, right=right, guard=guard)


def test_all_listeners_get_everything_that_is_seen() -> None:
    still, moved = picture(), picture(moved_px=3.0)
    left = Camera(*[still] * (DROPPED_PICTURES + 1), moved, fails=True)
    looking = eyes(left, Camera(still))
    listeners = [looking.sights() for _ in range(2)]
    with looking:
        seen = [[next(listener).movement_px()[0] for _ in range(2)] for listener in listeners]
    assert seen == [[0.0, pytest.approx(3 * 2**0.5, abs=0.1)]] * 2
    for listener in (*listeners, looking.sights()):
        with pytest.raises(DeviceFault, match="stopped sending"):
            next(listener)


def test_damaged_gel_stops_the_station_and_names_the_side() -> None:
    guard = Guarded()
    still, torn = picture(), picture(torn=True)
    right = Camera(*[still] * (DROPPED_PICTURES + 2), torn)
    with eyes(Camera(still), right, guard) as looking:
        looking.wait(4)
    assert guard.reasons
    assert set(guard.reasons) == {guard.reasons[0]}
    assert guard.reasons[0].startswith("The right gel is damaged or covered: ")
    assert guard.seen > 0


def test_eyes_at_rest_take_few_pictures_and_the_guard_sees_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    guard, waits, still = Guarded(), list[float](), picture()
    monkeypatch.setattr("vitac.station.eyes.sleep", waits.append)
    with eyes(Camera(still), Camera(still), guard) as looking:
        looking.wait(2)
        assert not waits
        looking.rests = True
        looking.wait(3)
    assert len(waits) >= 2
    assert set(waits) == {0.1}, "the heartbeat must be in time"
    assert guard.seen == 2 * looking.pairs


def test_tracker_of_one_side_starts_again() -> None:
    still, moved = picture(), picture(moved_px=2.0)
    pictures = [still] * (DROPPED_PICTURES + 1) + [moved]
    with eyes(Camera(*pictures), Camera(*pictures)) as looking:
        looking.wait(3)
        looking.restart_trackers(Finger.LEFT)
        assert looking.see().movement_px() == pytest.approx((0.0, 2 * 2**0.5), abs=0.1)
