"""Re-simulates the episodes of a shard from an uploaded log, where `policy.run_shard` plays them.

Called by `execution`. No policy runs, so no sandbox is needed.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from ..episodes.episode import Environment, MakeEnvironment, make_environment
from ..episodes.provenance import make_manifest
from ..episodes.records import EpisodeRecord, Manifest
from ..logs.checks import explain_impossible, must_agree
from ..logs.findings import LogFinding
from ..logs.log import LogReader
from ..logs.packing import open_log
from ..logs.verification import check_episode
from ..tracks import Task, Track
from ..tracks.cut import Shard
from .result import ShardEnd, ShardResult


@dataclass(frozen=True, kw_only=True)
class LogShard:
    """A shard of an uploaded log that is to be re-simulated.

    Attributes:
        log: the file, packed or not.
        track: the track of the task.
        task: what was played.
        shard: which episodes.
        skip: those of them that have a record already.
        make_env: gives the environment.
    """

    log: Path
    track: Track
    task: Task
    shard: Shard
    skip: Collection[int] = ()
    make_env: MakeEnvironment = make_environment

    @property
    def numbers(self) -> frozenset[int]:
        """Episodes that are left to re-simulate."""
        return self.shard.numbers - set(self.skip)

    def result(self, manifest: Manifest, finding: LogFinding | None) -> ShardResult:
        """Return what the shard ends with."""
        end = ShardEnd.REFUTED if finding else ShardEnd.COMPLETE
        return ShardResult(index=self.shard.index, end=end, manifest=manifest, isolation=None, finding=finding)


def resimulate_log(part: LogShard, on_episode: Callable[[EpisodeRecord], None]) -> ShardResult:
    """Re-simulate a shard of one of our logs, in the order of its episodes and until one diverges.

    Args:
        part: what is re-simulated.
        on_episode: gets each record of the re-simulation that holds.

    Raises:
        LogRejected: the log cannot be read.
    """
    env = part.make_env(part.task, None, ())
    manifest = make_manifest(part.track, part.task, env)
    finding = _explain_impossible(part, manifest) or _first_divergence(part, env, manifest, on_episode)
    return part.result(manifest, finding)


def _explain_impossible(part: LogShard, manifest: Manifest) -> LogFinding | None:
    """Return the upload was checked, but not against the mesh and the solver, which only an environment knows."""
    with open_log(part.log) as stream:
        reader = LogReader(stream)
        found = explain_impossible(must_agree(manifest), part.task, reader.header, reader.records())
    return LogFinding.impossible(found) if found else None


def _first_divergence(
    part: LogShard, env: Environment, manifest: Manifest, on_episode: Callable[[EpisodeRecord], None]
) -> LogFinding | None:
    with open_log(part.log) as stream:
        reader = LogReader(stream)
        for record in reader.records():
            if record.episode not in part.numbers:
                continue
            checked = check_episode(env, part.task, manifest, reader.header, record)
            if checked.finding:
                return checked.finding
            on_episode(checked.record)
    return None
