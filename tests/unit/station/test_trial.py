"""Trials at a twin, by policies that know where the hole is: every way in which an attempt can end."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scripted_policies import Act, Scripted
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.records import Observation, make_reading
from vitac.evaluator.strict_model import validate
from vitac.evaluator.tracks import Episode, load_track
from vitac.station import trial
from vitac.station.arm import Arm
from vitac.station.description import StationDescription
from vitac.station.eyes import NoProcedure, OpenStation, open_station
from vitac.station.outcome import TrialOutcome
from vitac.station.rehearsal import RehearsalReport, TrialRecord
from vitac.station.touch_gap import measure_touch_gap
from vitac.station.trial import Attempt, StationTrial
from vitac.station.twin.grasp import HOLE
from vitac.station.twin.hidden import PUBLIC_SETTINGS, HiddenSettings, TwinFault
from vitac.station.twin.laboratory import RunningTwin, TwinStation, twin_process

TASK = load_track("track_1").tasks["peg-insertion"]
START = (2.0, -1.5, 3.0)


def to_the_hole(observation: Observation, number: int) -> NDArray[np.float32]:
    """Go to the hole at once: the public twin's is where its file says."""
    del observation
    x, y, theta_deg = START
    angle = np.radians(theta_deg)
    along = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    return np.array((-along[0] / 2, -along[1] / 2, -theta_deg / 4), np.float32) * (number == 1)


def away(observation: Observation, number: int) -> NDArray[np.float32]:
    del observation, number
    return np.array((1.0, -1.0, 0.0), np.float32)


def nowhere(observation: Observation, number: int) -> NDArray[np.float32]:
    del observation, number
    return np.zeros(3, np.float32)


@pytest.fixture(scope="module")
def twin() -> Iterator[RunningTwin]:
    with twin_process(HiddenSettings(latency_s=0.0), period_s=0.2) as running:
        gripper = {"position": [0, 250], "speed": 200, "force": 50}
        running.description["limits"] |= {"gripper": gripper}
        yield running


@pytest.fixture
def station(twin: RunningTwin) -> Iterator[OpenStation]:
    while not twin.is_whole():
        Event().wait(0.05)
    with open_station(validate(StationDescription, twin.description, "station.yaml")) as opened:
        yield opened


@pytest.fixture
def play(station: OpenStation, tmp_path: Path) -> Callable[..., tuple[Attempt, Scripted]]:
    """Plays an attempt from a start, with a policy."""

    def play_trial(act: Act, start: tuple[float, float, float] = START) -> tuple[Attempt, Scripted]:
        session = Scripted(act)
        episode = Episode(number=1, shape="cuboid", offset=start, offset_option="offset_mm_deg", list_seed=0)
        played = StationTrial(
            station,
            task=TASK,
            episode=episode,
            reading=make_reading(TASK),
            open_session=lambda: session,
            folder=tmp_path,
        )
        return played.play(), session

    return play_trial


Play = Callable[..., tuple[Attempt, Scripted]]


@pytest.mark.slow(minutes=2)  # the file, which one process plays
def test_peg_that_goes_to_its_hole_passes_the_push_test_and_is_lifted(play: Play, station: OpenStation) -> None:
    attempt, session = play(to_the_hole)
    assert attempt.outcome is TrialOutcome.SUCCESS, attempt.reason
    first, *_, last = attempt.encoders
    assert first[:2] == pytest.approx(START[:2], abs=0.01)  # the fixed offset was really used
    assert last[:2] == pytest.approx((0.0, 0.0), abs=0.02)
    assert station.stage.status().pose.z_mm > HOLE[2] + 4
    seen = session.seen[-1]
    assert seen["marker_flow"].shape == (2, 2, 128, 2)
    assert seen["relative_motion"][:3] == pytest.approx([-2.0, 1.5, -3.0], abs=0.02)
    assert seen["relative_motion"][3] == pytest.approx(-0.125 * (len(session.seen) - 1), abs=0.01)


@pytest.mark.slow
def test_next_start_of_the_list_takes_the_place_of_one_over_the_hole(play: Play) -> None:
    attempt, session = play(nowhere, (0.0, 0.0, 0.0))
    assert attempt.start == next(each.offset for each in TASK.episodes[1:] if each.shape == "cuboid")
    assert attempt.encoders[0][:2] == pytest.approx(attempt.start[:2], abs=0.01)
    assert len(session.seen) == len(attempt.actions) > 0


@pytest.mark.slow
def test_starts_over_the_hole_are_not_blocked(play: Play, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "_STARTS", 1)
    attempt, session = play(nowhere, (0.0, 0.0, 0.0))
    assert attempt.outcome is TrialOutcome.NOT_BLOCKED
    assert session.seen == []


@pytest.mark.slow
def test_peg_is_fetched_again_where_the_zero_of_the_forces_has_drifted(
    play: Play, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_zero, opened = iter((False, True)), list[Arm]()
    open_in_garage = Arm.open_in_garage

    def note(arm: Arm, *beside_mm: Any) -> None:
        opened.append(arm)
        open_in_garage(arm, *beside_mm)

    monkeypatch.setattr(trial, "has_zero", lambda _: next(has_zero))
    monkeypatch.setattr(Arm, "open_in_garage", note)
    attempt, _ = play(nowhere)
    assert attempt.outcome.counts, attempt.reason
    assert next(has_zero, None) is None
    assert len(opened) == 2


@pytest.mark.slow
def test_action_out_of_range_moves_nothing(play: Play, station: OpenStation) -> None:
    attempt, _ = play(away, (11.5, 0.0, 0.0))
    assert attempt.outcome is TrialOutcome.ERROR
    assert len(attempt.encoders) == len(attempt.actions) == 1
    assert station.stage.status().pose[:2] == pytest.approx((11.5, 0.0))


@pytest.mark.slow
def test_action_that_is_no_number_fails_the_policy_and_moves_nothing(play: Play, station: OpenStation) -> None:
    def nan(observation: Observation, number: int) -> NDArray[np.float32]:
        raise PolicyFailed(VerdictCode.NON_FINITE_ACTION, "The action holds NaN.")

    attempt, _ = play(nan)
    assert (attempt.outcome, attempt.reason) == (TrialOutcome.POLICY_FAILED, "The action holds NaN.")
    assert attempt.actions == []
    assert station.stage.status().pose[:2] == pytest.approx(START[:2])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "outcome", "reason"),
    [
        (TwinFault.DROPPED_PEG, TrialOutcome.NO_PEG, "lost its peg"),
        (TwinFault.STAGE_ALARM, TrialOutcome.DEVICE_FAULT, "limit switch"),
        (TwinFault.FORCE_SPIKE, TrialOutcome.STOPPED, "Force "),
        (TwinFault.FROZEN_STREAM, TrialOutcome.DEVICE_FAULT, "is frozen"),
        (TwinFault.UNPLUGGED_CAMERA, TrialOutcome.DEVICE_FAULT, "stopped sending"),
        (TwinFault.NETWORK_CUT, TrialOutcome.DEVICE_FAULT, "force/torque box"),
        (TwinFault.STUCK_GRIPPER, TrialOutcome.DEVICE_FAULT, "gripper"),
    ],
)
def test_fault_has_its_own_outcome_and_the_next_attempt_plays(
    play: Play, twin: RunningTwin, fault: TwinFault, outcome: TrialOutcome, reason: str
) -> None:
    def break_it(observation: Observation, number: int) -> NDArray[np.float32]:
        twin.begin(fault, for_s=3.0)
        return nowhere(observation, number)

    attempt, _ = play(break_it)
    assert (attempt.outcome, attempt.outcome.counts) == (outcome, False), attempt.reason
    assert reason in attempt.reason


@pytest.mark.slow
def test_part_that_a_killed_agent_left_pressed_is_lifted_before_limits_are_watched(twin: RunningTwin) -> None:
    with open_station(validate(StationDescription, twin.description, "station.yaml")) as opened:
        arm = Arm(opened)
        arm.fetch()
        above = arm.place(START, opened.procedure.safe_z_mm)
        arm.go(above)
        arm.go(above._replace(z_mm=arm.height_mm(-1.0)), 1.0)
        opened.eyes.wait(3)
        wrench = opened.guard.wrench()
    assert wrench is not None
    pressed_n = math.hypot(*wrench[:3])
    assert pressed_n > 1.0
    limits = {**twin.description["limits"], "force_n": pressed_n / 2}
    with open_station(validate(StationDescription, twin.description | {"limits": limits}, "station.yaml")) as opened:
        opened.eyes.wait(3)
        assert opened.guard.reason is None
        assert opened.stage.status().pose.z_mm == pytest.approx(opened.procedure.safe_z_mm, abs=0.1)


def test_station_without_a_procedure_cannot_play(twins: TwinStation) -> None:
    described = twins.description
    with (
        pytest.raises(NoProcedure, match="has no `procedure`"),
        open_station(validate(StationDescription, described, "station.yaml")),
    ):
        pass


@pytest.mark.slow
def test_markers_and_forces_of_a_trial_are_those_of_our_simulation_of_its_motion(play: Play) -> None:
    attempt, _ = play(nowhere)
    assert attempt.outcome.counts, attempt.reason
    episode = Episode(number=1, shape="cuboid", offset=START, offset_option="offset_mm_deg", list_seed=0)
    record = TrialRecord.from_attempts(episode, [attempt])
    names = {"station": "twin", "submission": "s", "submission_digest": "d", "track": "t", "task": "p"}
    report = RehearsalReport.from_trials([record], hole=HOLE, **names)
    same, softer = (
        measure_touch_gap([report], PUBLIC_SETTINGS.model_copy(update={"youngs_modulus_pa": modulus_pa}))
        for modulus_pa in (3e5, 1.5e5)
    )
    assert same.markers_px["all"].value < 1.0
    assert same.force_n.value < 0.5 * softer.force_n.value
    by_frequency = sum(same.markers_px[part].value ** 2 for part in ("trial mean", "slow", "fast"))
    assert by_frequency == pytest.approx(same.markers_px["all"].value ** 2)
