"""Plays a shard whose task has several episodes at once in one simulation; called by `execution`."""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import ceil
from threading import Lock
from typing import TYPE_CHECKING

from vitac.errors import VitacError

from ..agent.isolation.cgroup import memory_limit_bytes
from ..agent.limits import GIB, Limits
from ..cores import count_cores
from ..episodes.records import EpisodeRecord, make_reading
from ..scoring.score import is_broken
from ..submission.manifest import load_manifest
from ..tracks import Episode
from .order import OrderedShard, ShardEnd, ShardResult
from .policy import LoadPolicy, load_in_sandbox, run_shard, secret_order

if TYPE_CHECKING:
    from vitac.envs.maniskill.env import ManiSkillEnv


class MachineTooSmall(VitacError):
    """The policies of a batch may use more memory than there is: take a smaller batch_size or another machine."""


def run_batches(
    ordered: OrderedShard, on_episode: Callable[[EpisodeRecord], None], load_policy: LoadPolicy = load_in_sandbox
) -> ShardResult:
    """Share the episodes of a shard out among the scenes of a batch, and play each part as a shard of its own.

    Each scene has the policy in a sandbox of its own, with the limits of a shard, by the clock for as many policies as
    share a core: they act at the same time and know nothing of one another. Which scene plays which episodes is as
    secret as their order. Failures of all count together, so that a broken policy is given up as early as one that
    plays alone.

    Args:
        ordered: what is played.
        on_episode: gets each record as soon as its episode is over, one at a time.
        load_policy: loads the policy of a submission; in the sandbox by default.

    Raises:
        MachineTooSmall: it has too little memory for this number of policies.
        VitacError: a sandbox or the simulation broke. This is never the team's fault; run the shard again.
    """
    from vitac.envs.maniskill.batch import Batch

    order, task, shard = ordered.order, ordered.task, ordered.shard
    reading = make_reading(task, load_manifest(order.submission).read_keys)
    episodes = secret_order(episode for episode in shard.episodes if episode.number not in order.skip)
    size = max(1, min(task.definition.batch_size, len(episodes)))
    limits = limits_of_each(size, order.limits)
    batch = Batch(
        task.env_id, max_steps=task.max_steps, observation_keys=reading.sent, settings=dict(task.settings)
    )  # fmt: skip
    failures = list(order.earlier_failures)
    one_at_a_time = Lock()

    def finished(record: EpisodeRecord) -> None:
        with one_at_a_time:
            on_episode(record)

    def play(part: tuple[Episode, ...], env: "ManiSkillEnv") -> ShardResult:
        return run_shard(
            submission_dir=order.submission,
            track=ordered.track,
            task=task,
            shard=replace(shard, episodes=part),
            on_episode=finished,
            reading=reading,
            limits=limits,
            failures=failures,
            load_policy=load_policy,
            make_env=lambda *_: env,
        )

    results = batch.play([partial(play, tuple(episodes[index::size])) for index in range(size)])
    isolated = next((result for result in results if result.isolation), results[0])
    return isolated.model_copy(update={"end": ShardEnd.BROKEN if is_broken(failures) else ShardEnd.COMPLETE})


def limits_of_each(policies: int, limits: Limits) -> Limits:
    """Return the limits of each policy where this number of them load and act at the same time on this machine.

    Those on CPU time and memory stay. Those by the clock grow with the number of policies that share a core, so that
    none fails because the others are busy.

    Args:
        policies: that play at the same time.
        limits: of a policy that plays alone.

    Raises:
        MachineTooSmall: the machine, or the container that this runs in, has less memory than all may use together.
            The kernel would kill one of them then, as if that one had used too much.
    """
    needed, machine = policies * limits.memory_bytes, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    group = memory_limit_bytes() or machine
    if needed > min(group, machine):
        there = f"the control group (of a container, say) allows {group / GIB:.1f}"
        if group >= machine:
            there = f"this machine has {machine / GIB:.1f}"
        raise MachineTooSmall(
            f"{policies} policies at once may use {needed / GIB:.1f} GiB of memory, {there} GiB; take a smaller "
            "batch_size or more memory."
        )
    sharing = ceil(policies / count_cores())
    return replace(
        limits,
        start_wall_s=sharing * limits.start_wall_s,
        action_wall_s=sharing * limits.action_wall_s,
        shard_wall_s=sharing * limits.shard_wall_s,
    )
