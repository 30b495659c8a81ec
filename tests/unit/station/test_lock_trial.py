"""The lock task at a twin, by policies that know where the slots are: a procedure of ours."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scripted_policies import Act, Scripted
from vitac.evaluator.episodes.records import Observation, make_reading
from vitac.evaluator.strict_model import validate
from vitac.evaluator.tracks import Episode, load_track
from vitac.station.description import StationDescription, StationTask
from vitac.station.eyes import OpenStation, open_station
from vitac.station.lock_trial import LockTrial
from vitac.station.outcome import TrialOutcome
from vitac.station.trial import Attempt
from vitac.station.twin.grasp import HOLE, Mounted
from vitac.station.twin.hidden import HiddenSettings
from vitac.station.twin.laboratory import twin_process

TASK = load_track("track_1").tasks["lock-opening"]
SLOT_MM = 6.5
"""From where a key is deepest to where its teeth stand below their slots."""
START_MM = 4.5


@pytest.fixture(scope="module")
def station() -> Iterator[OpenStation]:
    hidden, key = HiddenSettings(latency_s=0.0), Mounted(StationTask.LOCK, "key1")
    with (
        twin_process(hidden, mounted=key, period_s=0.2) as running,
        open_station(validate(StationDescription, running.description, "station.yaml")) as opened,
    ):
        yield opened


Play = Callable[[Act], tuple[Attempt, Scripted]]


@pytest.fixture
def play(station: OpenStation, tmp_path: Path) -> Play:
    """Plays an attempt with a policy."""

    def play_trial(act: Act) -> tuple[Attempt, Scripted]:
        session = Scripted(act, "lock-opening", 2)
        trial = LockTrial(
            station,
            task=TASK,
            episode=Episode(number=1, shape="key1", offset=(START_MM, 0, 0), offset_option="offset_mm", list_seed=0),
            reading=make_reading(TASK),
            open_session=lambda: session,
            folder=tmp_path,
        )
        return trial.play(), session

    return play_trial


def out_and_up(observation: Observation, number: int) -> NDArray[np.float32]:
    """Pull the key below its slots, then lift it."""
    del observation
    return np.array((-(SLOT_MM - START_MM) / 2, 0.0) if number == 1 else (0.0, -1.0), np.float32)


def up(observation: Observation, number: int) -> NDArray[np.float32]:
    del observation, number
    return np.array((0.0, -1.0), np.float32)


def out(observation: Observation, number: int) -> NDArray[np.float32]:
    """Pull the key out of its lock, and lift it there."""
    return np.array((-1.0, 0.0) if observation["relative_motion"][0] < 60.0 else (0.0, -1.0), np.float32)


@pytest.mark.slow
def test_key_that_is_lifted_into_its_slots_resists_a_pull_and_is_taken_out(play: Play, station: OpenStation) -> None:
    attempt, session = play(out_and_up)
    assert attempt.outcome is TrialOutcome.SUCCESS, attempt.reason
    assert len(attempt.actions) == 6
    motion_mm = session.seen[-1]["relative_motion"]
    assert motion_mm == pytest.approx((SLOT_MM - START_MM, 0.0, 4.0), abs=0.02)
    pose = station.stage.status().pose
    assert (pose.x_mm > 70.0, abs(pose.z_mm - HOLE[2]) < 2.1) == (True, True)  # in front of its lock


@pytest.mark.slow
def test_key_below_the_ceiling_is_felt(play: Play) -> None:
    attempt, _ = play(up)
    assert attempt.outcome in (TrialOutcome.TACTILE, TrialOutcome.STOPPED, TrialOutcome.ERROR)
    assert max(map(max, attempt.movement_px)) > 5.0


@pytest.mark.slow
def test_key_that_is_lifted_outside_of_its_lock_opens_nothing(play: Play) -> None:
    attempt, session = play(out)
    assert session.seen[-1]["relative_motion"][2] > 4.5
    assert attempt.outcome is TrialOutcome.ERROR, attempt.reason
