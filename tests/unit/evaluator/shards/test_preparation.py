from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from evaluation_fakes import FakeEnvironment, FakeSession, cannot_load, small_track, succeed
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed
from vitac.evaluator.shards import execution
from vitac.evaluator.shards.order import ShardOrder, ShardResult
from vitac.evaluator.shards.policy import Preparation
from vitac.evaluator.submission_kinds import SubmissionKind

TASK = small_track().tasks["peg-insertion"]


def order(shard: int, submission: str = "one") -> ShardOrder:
    return ShardOrder.model_validate(
        {"kind": "model", "submission": Path(submission), "track": "track_1", "task": "peg-insertion", "shard": shard}
    )


def make_environment(*_: object) -> Any:
    return FakeEnvironment()


def open_policy(preparation: Preparation, session: FakeSession) -> Any:
    with preparation.policy(session.load, Path("one"), Limits()) as opened:
        return opened


@pytest.fixture
def session() -> FakeSession:
    return FakeSession(succeed)


def test_policy_stays_loaded_from_shard_to_shard_and_each_has_its_own_time(session: FakeSession) -> None:
    with Preparation() as preparation:
        for shard in range(3):
            preparation.begin(order(shard))
            assert open_policy(preparation, session) is session
            assert session.open
        assert (session.loads, session.shards) == (1, 2)
    assert not session.open


def test_environment_serves_all_shards_of_a_submission(session: FakeSession) -> None:
    with Preparation() as preparation:
        preparation.begin(order(0))
        first = preparation.environment(make_environment, TASK, None, None)
        preparation.begin(order(1))
        assert preparation.environment(make_environment, TASK, None, None) is first
        preparation.begin(order(0, "other"))
        assert preparation.environment(make_environment, TASK, None, None) is not first


def test_another_submission_ends_the_policy_and_loads_its_own(session: FakeSession) -> None:
    other = FakeSession(succeed)
    with Preparation() as preparation:
        preparation.begin(order(0))
        open_policy(preparation, session)
        preparation.begin(order(0, "other"))
        assert not session.open
        assert open_policy(preparation, other) is other
        assert (session.loads, other.loads, other.shards) == (1, 1, 0)


def test_policy_that_could_not_be_loaded_is_loaded_again_for_the_next_shard(session: FakeSession) -> None:
    @contextmanager
    def refuse(*_: object) -> Iterator[Any]:
        with cannot_load() as never:
            yield never

    with Preparation() as preparation:
        preparation.begin(order(0))
        with pytest.raises(PolicyFailed), preparation.policy(refuse, Path("one"), Limits()):
            pytest.fail("it was loaded")
        preparation.begin(order(1))
        assert open_policy(preparation, session) is session


def test_a_fault_of_ours_ends_the_sandbox_before_it_is_told(
    session: FakeSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    def break_down(*_: object) -> ShardResult:
        raise SandboxFailed("bwrap is missing")

    monkeypatch.setattr(execution, "RUNNERS", {SubmissionKind.MODEL: break_down})
    told: list[tuple[str, bool]] = []

    class Answer(StringIO):
        def write(self, text: str) -> int:
            told.append((text, session.open))
            return len(text)

    with Preparation() as preparation:
        preparation.begin(order(0))
        open_policy(preparation, session)
        assert session.open
        execution.execute(order(0), Answer(), preparation)
    assert told == [('{"error":"SandboxFailed: bwrap is missing"}\n', False)]
