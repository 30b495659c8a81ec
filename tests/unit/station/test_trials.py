"""Which attempts are repeated, and what the service gets of those that count."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.episodes.reading import make_reading
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks import Episode, load_track
from vitac.station import trials
from vitac.station.agent import make_record
from vitac.station.devices.device import DeviceNotFound
from vitac.station.devices.stage import Pose
from vitac.station.outcome import ATTEMPTS, TrialOutcome
from vitac.station.records import TrialRecord
from vitac.station.rehearsal import RehearsalReport
from vitac.station.trial import Attempt
from vitac.station.trials import Player

TASK = load_track("track_1").tasks["peg-insertion"]
EPISODE = Episode(number=7, shape="cuboid", offset=(1.0, 2.0, 3.0), offset_option="offset_mm_deg", list_seed=0)


class Laboratory:
    """A station whose attempts end as a test says; counts how often its devices were opened."""

    def __init__(self, *outcomes: TrialOutcome | None) -> None:
        self.outcomes, self.opened, self.reasons = list(outcomes), 0, list[str]()

    @contextmanager
    def open_station(self, _: object) -> Iterator[Any]:
        self.opened += 1
        if self.outcomes[0] is None:
            self.outcomes.pop(0)
            raise DeviceNotFound("No stage.")
        yield SimpleNamespace(guard=SimpleNamespace(reason=None))

    def trial(self, *_: object, **__: object) -> Any:
        outcome = self.outcomes.pop(0)
        assert outcome is not None
        return SimpleNamespace(play=lambda: Attempt(outcome=outcome, reason=str(outcome)))

    def play(self, monkeypatch: pytest.MonkeyPatch) -> list[TrialOutcome]:
        monkeypatch.setattr(trials, "open_station", self.open_station)
        monkeypatch.setattr(trials, "Trial", self.trial)
        description: Any = None
        with Player(description=description, folder=Path(), make_safe=self.reasons.append) as player:
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


def test_trial_without_an_attempt_that_counts_is_no_result() -> None:
    records = [TrialRecord.from_attempts(EPISODE, [Attempt(outcome=outcome)]) for outcome in (S, T)]
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
        outcome=TrialOutcome.TACTILE, actions=actions, encoders=poses, movement_px=[(0.1, 0.2), (3.0, 4.0)]
    )
    record = make_record(TASK, EPISODE, attempt)
    assert (record.outcome, record.env_steps, record.initial_offset) == (EpisodeOutcome.TACTILE, 2, (1.0, 2.0, 3.0))
    assert record.infos == ({"encoders": [0.5, 1.5, -40.2, 2.0], "movement_px": [3.0, 4.0]}, {})
    assert len(set(record.state_hashes)) == 3


def test_failure_of_a_policy_is_in_its_record() -> None:
    failed = PolicyFailed(VerdictCode.NON_FINITE_ACTION, "The action holds NaN.")
    record = make_record(TASK, EPISODE, Attempt(outcome=TrialOutcome.POLICY_FAILED, failure=failed))
    assert record.failure is not None
    assert (record.failure.code, record.env_steps) == (VerdictCode.NON_FINITE_ACTION, 0)
