"""Plays the trials of a shard for the service; a worker uses it in place of a process that simulates."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from pydantic import JsonValue
from vitac.errors import VitacError
from vitac.evaluator.agent.isolation.packages import installed_packages
from vitac.evaluator.agent.session import Isolation
from vitac.evaluator.agent.verdicts import PolicyFailed
from vitac.evaluator.episodes.records import (
    ActionSequence,
    EpisodeOutcome,
    EpisodeRecord,
    FailureStage,
    PolicyFailure,
    Timings,
    TrialEvidence,
    canonical_json,
    make_manifest,
    make_reading,
)
from vitac.evaluator.scoring.score import is_broken
from vitac.evaluator.shards.order import AttemptSpent, ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.shards.policy import load_in_sandbox
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import Episode, Task
from vitac.evaluator.tracks.definition import cut
from vitac.evaluator.tracks.sealed import load_played_track, read_secret

from .description import StationDescription
from .rehearsal import pack_actions
from .trial import Attempt
from .trials import TrialPlayer


class _Devices:
    """Solver and meshes as a manifest names them; a station has neither."""

    solver_version: Final = "station"

    def mesh_hash(self) -> str:
        """Return one value for all stations."""
        return self.solver_version


class TrialNotPlayed(VitacError):
    """A trial has no result, since the station stopped; the service queues it again by its own rule."""


class StationShards:
    """Plays a worker's shards on one station, one at a time."""

    def __init__(self, player: TrialPlayer) -> None:
        """Use a player that makes one attempt at each trial: the service counts attempts."""
        self._player = player

    @contextmanager
    def running_shard(self, order: ShardOrder) -> Iterator["StationShard"]:
        """Return a shard whose trials are played as its records are asked for."""
        self._player.operator.open()
        yield StationShard(self._player, order)


class StationShard:
    """One shard at a station."""

    def __init__(self, player: TrialPlayer, order: ShardOrder) -> None:
        """Read what is to be played; nothing moves yet."""
        self._player, self._order = player, order
        self._track = load_played_track(order.track, read_secret(order.secret) if order.secret else None)
        self._task = self._track.task(order.task)
        self._isolation: Isolation | None = None
        self._failures = list(order.earlier_failures)
        self._is_killed = False
        self.packages: dict[str, str] | None = None
        self.video: Path | None = None

    @property
    def awaits_person(self) -> bool:
        """Whether an operator is asked or has paused the station."""
        return self._player.operator.is_awaited

    def kill(self) -> None:
        """Stop the station; the running trial has no record."""
        self._is_killed = True
        self._player.stop("The agent ends the trial.")

    def records(self) -> Iterator[EpisodeRecord]:
        """Yield the record of each trial as soon as it is over.

        Raises:
            TrialNotPlayed: the station stopped, or a trial could not be played on it.
        """
        order, mounted = self._order, self._player.description.procedure
        task = self._task.station_of or self._task.name
        if mounted is not None and mounted.task != task:
            raise TrialNotPlayed(f"The trials are of {task}; the station has {mounted.task} mounted.")
        shape = mounted.shape if mounted else "nothing"
        reading = make_reading(self._task, load_manifest(order.submission).observation_keys)
        self.packages = dict(installed_packages(self._track.packages).versions)
        with load_in_sandbox(order.submission, order.limits, self._track.packages) as session:
            self._isolation = session.isolation
            for episode in self._episodes():
                if is_broken(self._failures):
                    return
                if episode.shape != shape:
                    raise TrialNotPlayed(f"Trial {episode.number} needs the {episode.shape}; the {shape} is mounted.")
                (attempt,) = self._player.play(
                    self._task,
                    episode,
                    reading,
                    lambda: session,
                    order.code,
                    was_stopped_by_force=order.attempt > 1,
                )
                if attempt.stopped_by_force and not attempt.outcome.counts:
                    raise AttemptSpent(f"Trial {episode.number}: {attempt.outcome.sentence} {attempt.reason}")
                if self._is_killed or not attempt.outcome.counts:
                    raise TrialNotPlayed(f"Trial {episode.number}: {attempt.outcome.sentence} {attempt.reason}")
                if order.code is not None and attempt.video is None:
                    raise TrialNotPlayed(f"Trial {episode.number} has no whole video. {attempt.reason}")
                self.video = self._player.video_file if attempt.video else None
                record = make_record(self._task, episode, attempt, self._player.description)
                self._failures.extend([record.failure] if record.failure else [])
                yield record

    @property
    def result(self) -> ShardResult:
        """The result of the shard."""
        end = ShardEnd.BROKEN if is_broken(self._failures) else ShardEnd.COMPLETE
        manifest = make_manifest(self._track, self._task, _Devices())
        return ShardResult(index=self._order.shard, end=end, manifest=manifest, isolation=self._isolation)

    def _episodes(self) -> list[Episode]:
        shard = next(each for each in cut(self._task, self._order.episodes) if each.index == self._order.shard)
        return [each for each in shard.episodes if each.number not in self._order.skip]


def make_record(task: Task, episode: Episode, attempt: Attempt, station: StationDescription) -> EpisodeRecord:
    """Return the record of a trial; a state hash covers what was measured, the video so far, and the hash before."""
    measured = [_measured(attempt, number) for number in range(len(attempt.actions) + 1)]
    return EpisodeRecord(
        episode=episode.number,
        task=task.name,
        shape=episode.shape,
        initial_offset=attempt.start,
        outcome=EpisodeOutcome(attempt.outcome),
        env_steps=len(attempt.actions),
        total_reward=0.0,
        actions=ActionSequence.from_array(pack_actions(attempt)),
        state_hashes=tuple(_chained(measured)),
        infos=tuple(measured[1:]),
        forces=attempt.forces,
        evidence=TrialEvidence(station=station.name, twin=station.twin_words, video=attempt.video, help=attempt.help),
        failure=_failure(attempt.failure),
        timings=Timings(policy_s=attempt.policy_s),
        output=attempt.output,
    )


def _measured(attempt: Attempt, number: int) -> dict[str, JsonValue]:
    """Return what was measured after an env step; nothing where the motion was stopped or not made."""
    if number >= len(attempt.encoders):
        return {}
    mark: dict[str, JsonValue] = {"video": attempt.marks[number]} if attempt.marks else {}
    return {"encoders": list(attempt.encoders[number]), "movement_px": list(attempt.movement_px[number]), **mark}


def _chained(measured: list[dict[str, JsonValue]]) -> Iterator[str]:
    before = ""
    for each in measured:
        before = hashlib.sha256(before.encode() + canonical_json(each)).hexdigest()
        yield before


def _failure(failed: PolicyFailed | None) -> PolicyFailure | None:
    if failed is None:
        return None
    return PolicyFailure(
        stage=FailureStage.EPISODE, code=failed.verdict, message=failed.message, output_tail=failed.output_tail
    )
