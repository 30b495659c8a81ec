"""Finished shards are found again by all that decides what is in them, and by nothing else."""

import os
import sys
import time
from pathlib import Path

import pytest
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.evaluation import stored_shards
from vitac.evaluator.evaluation.local import LocalEvaluation, evaluate
from vitac.evaluator.evaluation.stored_shards import FinishedShard, StoredShards
from vitac.evaluator.figures.figures import FigureChoice
from vitac.evaluator.shards import host_process
from vitac.evaluator.shards.order import ShardOrder
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track

pytestmark = pytest.mark.usefixtures("fake_command")
TRACK = load_track("track_1")
TASK = TRACK.tasks["peg-insertion"]
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
    monkeypatch.setattr(stored_shards, "find_version", lambda _: "another")
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
