from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from evaluation_records import make_manifest
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.estimator.regression import Coefficients
from vitac.evaluator.evaluation.local import LocalEvaluation, evaluate
from vitac.evaluator.evaluation.stored_shards import FinishedShard
from vitac.evaluator.shards.host_process import ShardProcessFailed
from vitac.evaluator.shards.order import ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.cut import UnknownEpisodes

pytestmark = pytest.mark.usefixtures("fake_command")
TRACK = load_track("track_1")
TASK = TRACK.tasks["peg-insertion"]
SPREAD = (1, 2, 31, 61, 62)


def run(behaviour: str, **options: Any) -> LocalEvaluation:
    return evaluate(submission_dir=Path(behaviour), track=TRACK, task=TASK, **({"episodes": SPREAD} | options))


def test_one_and_many_workers_give_the_same_hash_and_score() -> None:
    one, many = run("succeed"), run("succeed", workers=3)
    assert one.result_hash == many.result_hash
    assert one.score == many.score
    assert [record.episode for record in many.records] == list(SPREAD)


@pytest.mark.usefixtures("one_fake_host")
def test_episodes_are_told_as_they_end() -> None:
    told: list[EpisodeRecord] = []
    evaluation = run("succeed", on_episode=told.append)
    assert sorted(told, key=lambda record: record.episode) == list(evaluation.records)


@pytest.mark.usefixtures("one_fake_host")
def test_score_is_of_the_records() -> None:
    evaluation = run("succeed")
    assert evaluation.score is not None
    assert (evaluation.score.successes, evaluation.score.mean_steps, evaluation.failure) == (5, 3.0, None)


@pytest.mark.usefixtures("one_fake_host")
def test_score_has_the_means_of_what_the_task_measures() -> None:
    evaluation = run("succeed")
    ends = [record.model_copy(update={"infos": [{"surface_diff_m": [1e-3, 2e-3]}]}) for record in evaluation.records]
    measured = replace(evaluation, records=tuple(ends)).score
    assert measured is not None
    assert measured.measures == pytest.approx({"surface_diff_mm": 2.0})


@pytest.mark.usefixtures("one_fake_host")
@pytest.mark.parametrize("workers", [1, 3])
def test_broken_policy_has_a_verdict_and_neither_score_nor_hash(workers: int) -> None:
    evaluation = run("cannot_load", workers=workers)
    assert evaluation.failure is not None
    assert evaluation.failure.code is VerdictCode.IMPORT_ERROR
    assert (evaluation.score, evaluation.result_hash) == (None, None)


@pytest.mark.usefixtures("one_fake_host")
def test_shards_after_a_broken_one_are_not_played() -> None:
    assert {record.episode for record in run("cannot_load").records} <= {1, 2}


@pytest.mark.usefixtures("one_fake_host")
def test_fault_of_the_machine_ends_the_evaluation_with_its_reason() -> None:
    with pytest.raises(ShardProcessFailed, match="bwrap is missing"):
        run("break_sandbox", workers=2)


def test_unknown_episode_is_refused_before_anything_runs() -> None:
    with pytest.raises(UnknownEpisodes):
        run("exit_early", episodes=[271])


class FirstShardStored:
    """What an ended evaluation left: its first shard, with what the estimator had learned."""

    def __init__(self, learned: Coefficients) -> None:
        self._learned = learned

    def load(self, order: ShardOrder) -> FinishedShard | None:
        manifest = make_manifest(task=order.task)
        ended = ShardResult(
            index=order.shard, end=ShardEnd.COMPLETE, manifest=manifest, isolation=None, coefficients=self._learned
        )
        return FinishedShard(records=(), result=ended) if order.shard == 0 else None

    def store(self, *_: object) -> None:
        """Keep nothing."""


@pytest.mark.usefixtures("one_fake_host")
@pytest.mark.parametrize("from_where", ["a shard that was stored", "the run before"])
def test_estimator_is_not_calibrated_to_a_sensor_that_it_knows(from_where: str, tmp_path: Path) -> None:
    """The fake calibrates for ever."""
    learned = Coefficients(mesh_hash="0" * 64, starts=7, regressions=())
    options: dict[str, Any] = {"coefficients": learned}
    if from_where == "a shard that was stored":
        options = {"stored": FirstShardStored(learned)}
    track = load_track("track_3")
    found = evaluate(
        submission_dir=Path("succeed"),
        track=track,
        task=track.tasks["sensor-standard"],
        episodes=(1, 28, 55),
        sensor=tmp_path,
        **options,
    )
    assert found.coefficients == learned
    assert not (tmp_path / "begun").exists()


def test_interrupt_ends_every_process() -> None:
    """Two shards hang; without their end the evaluation would never come back."""

    def interrupt(_: EpisodeRecord) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run("hang_after_first", workers=2, on_episode=interrupt)
