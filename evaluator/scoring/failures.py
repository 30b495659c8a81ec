"""When failures of a policy end its evaluation: called where a shard is played and where the last one ends."""

from collections.abc import Collection, Iterable, Sequence

from ..agent.verdicts import VerdictCode
from ..episodes.records import EpisodeRecord, FailureStage, PolicyFailure
from ..tracks.cut import ShardEpisodes

FAILURES_THAT_END_A_SHARD = 3
"""Number of policy failures in one shard that end the evaluation as failed: the policy is broken, not unlucky."""


def is_broken(failures: Collection[PolicyFailure]) -> bool:
    """Return whether a policy with these failures in one shard is given up."""
    return any(map(_ends_at_once, failures)) or len(failures) >= FAILURES_THAT_END_A_SHARD


def breaking_failure(shards: Sequence[ShardEpisodes], records: Iterable[EpisodeRecord]) -> PolicyFailure | None:
    """Return the failure that ends an evaluation as failed, or None while the policy works well enough to be scored.

    That is the first failure of the first shard that is broken, or there the one that ended it at once: a function of
    the records and the fixed cut only, so the same for any number of workers and for a resumed evaluation.
    """
    failures = {record.episode: record.failure for record in records if record.failure}
    for shard in sorted(shards, key=lambda shard: shard.index):
        in_shard = [failures[number] for number in sorted(shard.numbers & failures.keys())]
        if is_broken(in_shard):
            return next(filter(_ends_at_once, in_shard), in_shard[0])
    return None


def _ends_at_once(failure: PolicyFailure) -> bool:
    """Return whether no other episode of the shard could be played after this failure."""
    return failure.stage is FailureStage.LOAD or failure.code is VerdictCode.SHARD_TIME
