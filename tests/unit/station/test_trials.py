"""Which attempts are repeated, and what the service gets of those that count."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.envs.geometry.pegs import PegShape
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome, TrialEvidence, make_reading
from vitac.evaluator.shards.order import AttemptSpent, ShardEnd, ShardOrder
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Episode, load_track
from vitac.station import agent, trials
from vitac.station.agent import StationShard, StationShards, TrialNotPlayed, make_record
from vitac.station.description import Procedure, StationDescription, StationTask, TwinClass, TwinMark
from vitac.station.devices.stage import DeviceNotFound, Pose
from vitac.station.eyes import NoProcedure
from vitac.station.held_part import HeldPart
from vitac.station.operators import Operator
from vitac.station.outcome import ATTEMPTS, TrialOutcome
from vitac.station.rehearsal import RehearsalReport, StationRefused, TrialRecord, find_station_task, rehearse
from vitac.station.trial import Attempt
from vitac.station.trials import TrialPlayer

TASK = load_track("track_1").tasks["peg-insertion"]
EPISODE = Episode(number=7, shape="cuboid", offset=(1.0, 2.0, 3.0), offset_option="offset_mm_deg", list_seed=0)


LAB = StationDescription.model_construct(
    name="lab",
    twin=TwinMark(twin_class=TwinClass.B, without=("mesh",)),
    procedure=Procedure.model_construct(shape=PegShape.CUBOID),
)


class Laboratory:
    """A station whose attempts end as a test says; counts how often its devices were opened."""

    def __init__(self, *outcomes: TrialOutcome | None, by_force: bool = False) -> None:
        self.outcomes, self.opened, self.reasons, self.by_force = list(outcomes), 0, list[str](), by_force
        self.held_beside_mm = list[tuple[float, float]]()
        self.eyes = SimpleNamespace(rests=False)

    @contextmanager
    def open_station(self, _: object, held: HeldPart) -> Iterator[Any]:
        self.opened += 1
        if self.outcomes[0] is None:
            self.outcomes.pop(0)
            raise DeviceNotFound("No stage.")
        yield SimpleNamespace(guard=SimpleNamespace(reason=None), eyes=self.eyes, held=held)

    def trial(self, station: Any, **_: object) -> Any:
        assert not self.eyes.rests
        self.held_beside_mm.append(station.held.beside_mm)
        station.held.remember((1.5, -1.0))
        outcome = self.outcomes.pop(0)
        assert outcome is not None
        attempt = Attempt(start=EPISODE.offset, outcome=outcome, reason=str(outcome), stopped_by_force=self.by_force)
        return SimpleNamespace(play=lambda: attempt)

    def play(self, monkeypatch: pytest.MonkeyPatch) -> list[TrialOutcome]:
        monkeypatch.setattr(trials, "open_station", self.open_station)
        monkeypatch.setattr(trials, "_TRIALS", dict.fromkeys(StationTask, self.trial))
        description: Any = None
        operator: Any = SimpleNamespace(
            stop_reason=None, make_safe=self.reasons.append, begin=lambda _: None, end=lambda: ()
        )
        with TrialPlayer(description=description, folder=Path(), operator=operator) as player:
            attempts = player.play(TASK, EPISODE, make_reading(TASK), lambda: pytest.fail("nobody asks"))
        return [attempt.outcome for attempt in attempts]


S, T, N = TrialOutcome.STOPPED, TrialOutcome.TACTILE, TrialOutcome.NOT_BLOCKED


@pytest.mark.parametrize(
    ("outcomes", "played", "opened", "reasons"),
    [
        ([T], [T], 1, []),
        ([S, T], [S, T], 2, ["stopped"]),
        ([N, T], [N, T], 1, []),
        ([None, T], [TrialOutcome.DEVICE_FAULT, T], 2, ["No stage."]),
        ([S, S, S], [S] * ATTEMPTS, 3, ["stopped"] * 2),
    ],
)
def test_attempts_that_do_not_count_are_repeated_with_devices_opened_again_after_a_stop(
    monkeypatch: pytest.MonkeyPatch, outcomes: list[TrialOutcome | None], played: list[TrialOutcome], opened: int,
    reasons: list[str],
) -> None:  # fmt: skip
    laboratory = Laboratory(*outcomes)
    assert laboratory.play(monkeypatch) == played
    assert (laboratory.opened, laboratory.reasons) == (opened, reasons)
    assert laboratory.eyes.rests, "between trials nothing moves"


@pytest.mark.parametrize(
    ("task", "start"),
    [("peg-insertion", "x 1 mm, y -2 mm, turned 3 degrees"), ("lock-opening", "x 1 mm, y -2 mm, z 3 mm")],
)
def test_console_describes_a_start_as_its_task_means_it(task: str, start: str) -> None:
    episode = replace(EPISODE, offset=(1.0, -2.0, 3.0))
    assert trials._describe(load_track("track_1").tasks[task], episode, 1, None)["start"] == start


def test_reopened_station_knows_where_it_holds_its_part(monkeypatch: pytest.MonkeyPatch) -> None:
    laboratory = Laboratory(S, None, T)
    assert laboratory.play(monkeypatch) == [S, TrialOutcome.DEVICE_FAULT, T]
    assert laboratory.held_beside_mm == [(0.0, 0.0), (1.5, -1.0)]


def test_a_policy_that_the_limit_of_force_stops_twice_has_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Laboratory(S, S, by_force=True).play(monkeypatch) == [S, T]


def test_trial_without_an_attempt_that_counts_is_no_result() -> None:
    records = [
        TrialRecord.from_attempts(EPISODE, [Attempt(start=EPISODE.offset, outcome=outcome)]) for outcome in (S, T)
    ]
    names = {"station": "lab", "submission": "s", "submission_digest": "d", "track": "t", "task": "p"}
    report = RehearsalReport.from_trials(records, **names)
    assert (report.without_result, report.rate and report.rate.episodes) == (1, 1)
    assert RehearsalReport.from_trials(records[:1], **names).rate is None


def test_every_outcome_that_counts_is_one_of_the_service() -> None:
    assert {each.value for each in TrialOutcome if each.counts} <= {each.value for each in EpisodeOutcome}
    assert all(each.sentence for each in TrialOutcome)


def test_record_of_a_trial_has_what_was_measured_and_nothing_where_the_motion_was_stopped() -> None:
    poses = [Pose(1.0, 2.0, -40.0, 3.0), Pose(0.5, 1.5, -40.2, 2.0)]
    actions = [np.ones(3, np.float32), np.zeros(3, np.float32)]
    attempt = Attempt(
        start=EPISODE.offset,
        outcome=TrialOutcome.TACTILE,
        actions=actions,
        encoders=poses,
        movement_px=[(0.1, 0.2), (3.0, 4.0)],
    )
    record = make_record(TASK, EPISODE, attempt, LAB)
    assert (record.outcome, record.env_steps, record.initial_offset) == (EpisodeOutcome.TACTILE, 2, (1.0, 2.0, 3.0))
    assert record.infos == ({"encoders": [0.5, 1.5, -40.2, 2.0], "movement_px": [3.0, 4.0]}, {})
    assert len(set(record.state_hashes)) == 3
    assert record.evidence == TrialEvidence(station="lab", twin="a twin of class B without mesh, no hardware")


def test_failure_of_a_policy_is_in_its_record() -> None:
    failed = PolicyFailed(VerdictCode.NON_FINITE_ACTION, "The action holds NaN.")
    record = make_record(
        TASK, EPISODE, Attempt(start=EPISODE.offset, outcome=TrialOutcome.POLICY_FAILED, failure=failed), LAB
    )
    assert record.failure is not None
    assert (record.failure.code, record.env_steps) == (VerdictCode.NON_FINITE_ACTION, 0)


class Attempts:
    """A player on which a cuboid is mounted, whose attempts end as a test says."""

    def __init__(self, *outcomes: TrialOutcome, by_force: bool = False) -> None:
        self.outcomes, self.played, self.stopped = list(outcomes), list[int](), list[str]()
        self.by_force, self.was_stopped = by_force, list[bool]()
        self.description = LAB
        self.stop = self.stopped.append
        self.operator = Operator(asks=False)

    def play(self, _: object, episode: Episode, *__: object, was_stopped_by_force: bool) -> list[Attempt]:
        self.played.append(episode.number)
        self.was_stopped.append(was_stopped_by_force)
        return [Attempt(start=EPISODE.offset, outcome=self.outcomes.pop(0), stopped_by_force=self.by_force)]


def running(
    player: Any, shape: str, repository: Path, monkeypatch: pytest.MonkeyPatch, skip: int = 0, **facts: Any
) -> AbstractContextManager[StationShard]:
    """A shard of the first two starts of a shape; as many as `skip` says have a record."""
    monkeypatch.setattr(agent, "load_in_sandbox", lambda *_: nullcontext(SimpleNamespace(isolation=None)))
    numbers = tuple(each.number for each in TASK.episodes if each.shape == shape)[:2]
    folder = repository / "examples" / "peg_insertion_heuristic" / "Track_1"
    order = ShardOrder(
        kind=SubmissionKind.MODEL,
        submission=folder,
        track="track_1",
        task=TASK.name,
        shard=0,
        episodes=numbers,
        skip=numbers[:skip],
        **facts,
    )
    return StationShards(player).running_shard(order)


def test_shard_has_a_record_of_each_trial_without_one(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    player = Attempts(T, TrialOutcome.SUCCESS)
    with running(player, "cuboid", repository, monkeypatch) as shard:
        assert [each.outcome for each in shard.records()] == [EpisodeOutcome.TACTILE, EpisodeOutcome.SUCCESS]
        assert (shard.result.end, shard.result.manifest.solver_version) == (ShardEnd.COMPLETE, "station")
        assert shard.result.manifest.evaluator_parts
    again = Attempts(T)
    with running(again, "cuboid", repository, monkeypatch, skip=1) as shard:
        assert len(list(shard.records())) == 1
    assert again.played == player.played[1:]


def test_trials_of_another_task_than_the_mounted_one_are_not_played(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    player = Attempts(T)
    key = Procedure.model_construct(task=StationTask.LOCK, shape="key1")
    player.description = LAB.model_copy(update={"procedure": key})
    refusal = pytest.raises(TrialNotPlayed, match="The trials are of peg-insertion; the station has lock-opening mount")
    with running(player, "cuboid", repository, monkeypatch) as shard, refusal:
        next(shard.records())
    assert player.played == []


def test_a_rehearsal_needs_a_submission_to_what_is_mounted(repository: Path) -> None:
    folder = repository / "examples" / "lock_opening_trained" / "Track_1"
    sentence = "Expected a submission to peg-insertion, as `procedure.task` says, got one to lock-opening."
    with pytest.raises(StationRefused, match=sentence):
        rehearse(TrialPlayer(description=LAB, folder=folder), folder, load_track("track_1"))
    bare = LAB.model_copy(update={"procedure": None})
    with pytest.raises(NoProcedure, match="The file of lab has no `procedure`"):
        rehearse(TrialPlayer(description=bare, folder=folder), folder, load_track("track_1"))
    assert find_station_task(("lock-opening",)) is StationTask.LOCK
    with pytest.raises(StationRefused, match="the submission plays explore"):
        find_station_task(("explore",))


@pytest.mark.parametrize(
    ("shape", "outcome", "sentence"),
    [("cuboid", S, "Trial 1: "), ("trapezoid", T, "Trial 2 needs the trapezoid; the cuboid is mounted.")],
)
def test_trial_that_does_not_count_or_cannot_be_played_has_no_record(
    shape: str, outcome: TrialOutcome, sentence: str, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        running(Attempts(outcome), shape, repository, monkeypatch) as shard,
        pytest.raises(TrialNotPlayed, match=sentence),
    ):
        next(shard.records())


@pytest.mark.parametrize(("attempt", "was_stopped"), [(1, False), (2, True)])
def test_a_stop_by_force_costs_an_attempt_and_is_known_in_the_next(
    attempt: int, was_stopped: bool, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    player = Attempts(S, by_force=True)
    with (
        running(player, "cuboid", repository, monkeypatch, attempt=attempt) as shard,
        pytest.raises(AttemptSpent, match="Trial 1: A limit of the station was passed"),
    ):
        next(shard.records())
    assert player.was_stopped == [was_stopped]


def test_trial_whose_video_is_not_whole_has_no_record(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        running(Attempts(T), "cuboid", repository, monkeypatch, code="0" * 16) as shard,
        pytest.raises(TrialNotPlayed, match="Trial 1 has no whole video"),
    ):
        next(shard.records())


def test_killed_shard_stops_the_station_and_leaves_no_record(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    player = Attempts(T)
    with running(player, "cuboid", repository, monkeypatch) as shard:
        shard.kill()
        assert player.stopped == ["The agent ends the trial."]
        with pytest.raises(TrialNotPlayed):
            next(shard.records())
