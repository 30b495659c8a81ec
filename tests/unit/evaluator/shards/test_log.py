"""Shards of uploaded logs, with an environment that simulates nothing."""

from functools import partial
from pathlib import Path

import pytest
from evaluation_fakes import FakeEnvironment, FakeSession, action, small_track, succeed
from vitac.evaluator.episodes.episode import run_episode
from vitac.evaluator.episodes.records import EpisodeRecord, make_manifest
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.shards.execution import resimulate_log
from vitac.evaluator.shards.order import OrderedShard, ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks.definition import cut

TRACK = small_track(shard_size=6)
TASK = TRACK.tasks["peg-insertion"]


def played() -> list[EpisodeRecord]:
    """The whole list; every second episode is solved."""
    env, records = FakeEnvironment(), []
    for episode in TASK.episodes:
        session = FakeSession(succeed if episode.number % 2 else lambda *_: action(0.25))
        session.open = True
        records.append(run_episode(env=env, task=TASK, episode=episode, open_session=partial(lambda s: s, session)))
    return records


RECORDS = played()


def write(path: Path, records: list[EpisodeRecord], **manifest: str) -> Path:
    made_with = make_manifest(TRACK, TASK, FakeEnvironment()).model_copy(update=manifest)
    with path.open("wb") as stream:
        write_log(stream, LogHeader(team="Touch", manifest=made_with), records)
    return path


def resimulated(log: Path, shard: int = 0, skip: tuple[int, ...] = ()) -> tuple[ShardResult, list[EpisodeRecord]]:
    records: list[EpisodeRecord] = []
    order = ShardOrder(
        kind=SubmissionKind.LOG, submission=log, track=TRACK.name, task=TASK.name, shard=shard, skip=skip
    )
    part = OrderedShard(order=order, track=TRACK, task=TASK, shard=cut(TASK)[shard])
    return resimulate_log(part, records.append, lambda *_: FakeEnvironment()), records


def lie(number: int) -> list[EpisodeRecord]:
    """The records, the second state of one of them altered."""
    hashes = (RECORDS[number - 1].state_hashes[0], "f" * 64, *RECORDS[number - 1].state_hashes[2:])
    changed = RECORDS[number - 1].model_copy(update={"state_hashes": hashes})
    return [changed if record.episode == number else record for record in RECORDS]


def test_shards_of_a_true_log_give_the_records_of_its_evaluation(tmp_path: Path) -> None:
    log = write(tmp_path / "log", RECORDS)
    for shard in (0, 1):
        result, records = resimulated(log, shard)
        assert (result.index, result.end, result.finding, result.isolation) == (shard, ShardEnd.COMPLETE, None, None)
        assert [record.record_digest() for record in records] == [
            record.record_digest() for record in RECORDS[6 * shard : 6 * shard + 6]
        ]
        assert all(record.timings.wall_s > 0 for record in records)  # They tell how long the queue still takes.


def test_stored_episodes_are_left_out(tmp_path: Path) -> None:
    _, records = resimulated(write(tmp_path / "log", RECORDS), skip=(1, 4))
    assert [record.episode for record in records] == [2, 3, 5, 6]


def test_first_divergence_ends_the_shard_and_records_before_it_hold(tmp_path: Path) -> None:
    result, records = resimulated(write(tmp_path / "log", lie(3)))
    assert (result.end, [record.episode for record in records]) == (ShardEnd.REFUTED, [1, 2])
    assert result.finding is not None
    assert (result.finding.verdict, result.finding.reason, result.finding.episode) == (
        VerificationResult.DIVERGED, "diverged at episode 3, env step 1", 3,
    )  # fmt: skip
    assert resimulated(write(tmp_path / "other", lie(3)), shard=1)[0].end is ShardEnd.COMPLETE


@pytest.mark.parametrize("changes", [{"mesh_hash": "other"}, {"solver_version": "0"}])
def test_log_of_another_mesh_or_solver_is_impossible_in_every_shard(tmp_path: Path, changes: dict[str, str]) -> None:
    for shard in (0, 1):
        result, records = resimulated(write(tmp_path / f"log {shard}", RECORDS, **changes), shard)
        assert (result.end, records) == (ShardEnd.REFUTED, [])
        assert result.finding is not None
        assert (result.finding.verdict, result.finding.episode) == (VerificationResult.IMPOSSIBLE, None)


def test_a_log_with_other_pictures_is_refuted_by_its_own_finding(tmp_path: Path) -> None:
    picture = {"env_step": 1, "sha256": "a" * 64}
    seen = EpisodeRecord(**{**dict(RECORDS[1]), "picture": picture})
    result, records = resimulated(write(tmp_path / "log", [RECORDS[0], seen, *RECORDS[2:]]))
    assert (result.end, len(records)) == (ShardEnd.REFUTED, 1)
    assert result.finding is not None
    assert (result.finding.verdict, result.finding.episode) == (VerificationResult.OTHER_PICTURE, 2)
    assert result.finding.other_picture is not None
    assert result.finding.other_picture.recorded == seen.picture
    assert result.finding.other_picture.resimulated is None
