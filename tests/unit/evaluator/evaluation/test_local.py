"""Finished shards are found again by all that decides what is in them, and by nothing else."""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from evaluation_records import make_manifest
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.evaluation import local
from vitac.evaluator.evaluation.local import FinishedShard, LocalEvaluation, StoredShards, evaluate
from vitac.evaluator.figures.figures import FigureChoice
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.shards import host_process
from vitac.evaluator.shards.host_process import ShardProcessFailed
from vitac.evaluator.shards.order import ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import UnknownEpisodes

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


ORDER = ShardOrder(
    kind=SubmissionKind.MODEL, submission=Path("/a"), track="track_1", task="peg-insertion", shard=0, episodes=(1,)
)


def play(
    folder: Path,
    behaviour: str = "succeed",
    episodes: tuple[int, ...] = (1, 2, 61),
    figures: FigureChoice = FigureChoice.NONE,
) -> LocalEvaluation:
    stored = StoredShards(folder, of="digest of a sensor")
    return evaluate(
        submission_dir=Path(behaviour), track=TRACK, task=TASK, episodes=episodes, stored=stored, figures=figures
    )


def finished(folder: Path) -> FinishedShard:
    """One that was played."""
    play(folder, episodes=(1,))
    (file,) = folder.iterdir()
    content = FinishedShard.model_validate_json(file.read_bytes())
    file.unlink()
    return content


def test_ended_evaluation_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[EpisodeRecord] = []
    first = play(tmp_path, episodes=(1, 2))
    assert len(list(tmp_path.iterdir())) == 1
    whole = play(tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.setattr(host_process, "COMMAND", (sys.executable, "-c", "raise SystemExit(1)"))
    stored = StoredShards(tmp_path, of="digest of a sensor")
    again = evaluate(
        submission_dir=Path("elsewhere"),
        track=TRACK,
        task=TASK,
        episodes=(1, 2, 61),
        workers=2,
        stored=stored,
        on_episode=told.append,
    )
    assert again.result_hash == whole.result_hash != first.result_hash
    assert again.records == whole.records
    assert sorted(record.episode for record in told) == [1, 2, 61]


@pytest.mark.usefixtures("one_fake_host")
def test_shard_of_a_broken_policy_is_not_kept(tmp_path: Path) -> None:
    assert play(tmp_path, "cannot_load").failure is not None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("one_fake_host")
def test_only_the_same_shard_of_the_same_sensor_and_evaluator_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shard = finished(tmp_path)
    stored = StoredShards(tmp_path, of="a")
    stored.store(ORDER, shard.records, shard.result)
    for same in (ORDER, ORDER.model_copy(update={"submission": Path("/b"), "sensor": Path("/s")})):
        assert stored.load(same) == shard
    for other in ({"episodes": (1, 2)}, {"shard": 1}, {"task": "lock-opening"}, {"track": "track_3"}):
        assert stored.load(ORDER.model_copy(update=other)) is None
    assert StoredShards(tmp_path, of="b").load(ORDER) is None
    monkeypatch.setattr(local, "find_version", lambda _: "another")
    assert stored.load(ORDER) is None


@pytest.mark.usefixtures("one_fake_host")
def test_damaged_file_is_played_again(tmp_path: Path) -> None:
    shard = finished(tmp_path)
    stored = StoredShards(tmp_path, of="a")
    stored.store(ORDER, shard.records, shard.result)
    (file,) = tmp_path.iterdir()
    for content in (file.read_bytes()[:-9], b"", b"[]", b"\xff"):
        file.write_bytes(content)
        assert stored.load(ORDER) is None
    stored.store(ORDER, shard.records, shard.result)
    assert stored.load(ORDER) == shard


@pytest.mark.usefixtures("one_fake_host")
def test_what_nobody_used_for_a_month_is_removed(tmp_path: Path) -> None:
    shard = finished(tmp_path)
    stored = StoredShards(tmp_path, of="a")
    for number in (0, 1):
        stored.store(ORDER.model_copy(update={"shard": number}), shard.records, shard.result)
    old_s = time.time() - 31 * 86400
    for file in tmp_path.iterdir():
        os.utime(file, (old_s, old_s))
    assert stored.load(ORDER) == shard
    StoredShards(tmp_path, of="a")
    assert len(list(tmp_path.iterdir())) == 1
    assert stored.load(ORDER) == shard


@pytest.mark.usefixtures("one_fake_host")
def test_a_run_that_measures_no_figures_is_found_whichever_were_asked_for(tmp_path: Path) -> None:
    play(tmp_path, episodes=(1,), figures=FigureChoice.NONE)
    for figures in FigureChoice:
        play(tmp_path, episodes=(1,), figures=figures)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.usefixtures("one_fake_host")
def test_a_file_of_another_shard_is_played_again(tmp_path: Path) -> None:
    shard = finished(tmp_path)
    (record,) = shard.records
    stored = StoredShards(tmp_path, of="a")
    for records, index in (
        ((), 0),
        ((record,), 1),
        ((record, record.model_copy(update={"episode": 2})), 0),
        ((record.model_copy(update={"episode": 2}),), 0),
        ((record.model_copy(update={"task": "lock-opening"}),), 0),
    ):
        stored.store(ORDER, records, shard.result.model_copy(update={"index": index}))
        assert stored.load(ORDER) is None
    stored.store(ORDER, shard.records, shard.result)
    assert stored.load(ORDER) == shard
    all_of_it = ORDER.model_copy(update={"episodes": None})
    stored.store(all_of_it, shard.records, shard.result)
    assert stored.load(all_of_it) is None, "it does not say which episodes there must be"


@pytest.mark.usefixtures("one_fake_host")
def test_files_of_the_users_own_are_never_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shard = finished(tmp_path)
    digest = "0123456789abcdef" * 4
    own = (
        "notes.txt",
        "tmpab12cd34",
        "sensor.json",
        f"{digest}.json.bak",
        f"my-{digest}.json",
        f"{digest.upper()}.json",
    )
    for name in (*own, f"{digest}.json"):
        (tmp_path / name).write_text("stored for years")
    (tmp_path / f"{digest[::-1]}.json").mkdir()
    with monkeypatch.context() as killed:  # before the file has its name
        killed.setattr(Path, "replace", lambda *_: None)
        StoredShards(tmp_path, of="a").store(ORDER, shard.records, shard.result)
    assert len(list(tmp_path.iterdir())) == len(own) + 3
    old_s = time.time() - 31 * 86400
    for path in tmp_path.iterdir():
        os.utime(path, (old_s, old_s))
    StoredShards(tmp_path, of="a")
    assert {path.name for path in tmp_path.iterdir()} == {*own, f"{digest[::-1]}.json"}


@pytest.mark.usefixtures("one_fake_host")
def test_folder_that_cannot_be_written_keeps_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    whole = play(tmp_path / "file" / "folder")
    assert whole.result_hash == play(tmp_path / "stored").result_hash
