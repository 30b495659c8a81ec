"""Evaluations for boards that are exported and audited: records of made-up states, one of them really played."""

from collections.abc import Callable

import numpy as np
from service_factories import ISOLATION, claim, make_record, shard_ids
from sqlalchemy.dialects.postgresql import insert
from vitac.envs.tactile.design import SensorDesign
from vitac.evaluator.episodes.episode import Environment, make_environment, resimulate
from vitac.evaluator.episodes.records import ActionSequence, EpisodeRecord, make_manifest
from vitac.evaluator.shards.order import ShardEnd, ShardResult
from vitac.evaluator.tracks import find_task
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Submission
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.episode_store import row_values

EPISODES = 270
"""Of each task that these boards rank."""


def environment_of(task: str, sensor: SensorDesign | None = None) -> Environment:
    """Where a task is played."""
    return make_environment(find_task(task)[1], None, (), sensor=sensor)


def sampled(seed: int, logs: int) -> tuple[int, int]:
    """Of which log, from 0, and which episode an audit of one episode runs again."""
    index = int(np.random.default_rng(seed).choice(logs * EPISODES, size=1, replace=False)[0])
    return index // EPISODES, index % EPISODES + 1


def played_again(task: str, number: int, env: Environment) -> EpisodeRecord:
    """The record of an episode that really happens if the gripper does not move."""
    definition = find_task(task)[1]
    steps = np.zeros((definition.max_steps, 3), np.float32)
    played = resimulate(env, definition.episodes[number - 1], steps)
    assert played.end_step is not None
    assert played.outcome is not None
    n_steps = played.end_step
    return make_record(
        number,
        task=task,
        outcome=played.outcome,
        env_steps=n_steps,
        actions=ActionSequence.from_array(steps[:n_steps]),
        state_hashes=played.state_hashes[: n_steps + 1],
        infos=played.infos[:n_steps],
    )


def complete(
    database: Database, submission: Submission, env: Environment, record_of: Callable[[str, int], EpisodeRecord]
) -> None:
    """Runs all shards of a submission, as if they were played in an environment and gave these records."""
    with database.transaction() as session:
        ids = shard_ids(session, submission)
    for shard_id in ids:
        lease = claim(database, shard_id)
        records = [record_of(lease.task, number) for number in lease.episodes]
        manifest = make_manifest(*find_task(lease.task), env)
        with database.transaction() as session:
            session.execute(insert(EpisodeResult), [row_values(lease, record) for record in records])
            ended = ShardResult(index=lease.number, end=ShardEnd.COMPLETE, manifest=manifest, isolation=ISOLATION)
            lifecycle.finish_shard(session, lease, ended)
