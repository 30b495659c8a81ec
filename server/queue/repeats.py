"""Notes why a shard is queued again, for organizers; called by leases and the sweep."""

from datetime import UTC, datetime
from typing import Any

from ..database.models import Shard
from ..database.states import RepeatCause
from ..views.evaluations import RepeatView


def make_repeat(cause: RepeatCause, reason: str) -> dict[str, Any]:
    """Return what is stored of a repeat that begins now."""
    return RepeatView(at=datetime.now(UTC), cause=cause, reason=reason).model_dump(mode="json")


def count_losses(shard: Shard) -> int:
    """Return how often a shard's worker was lost."""
    return sum(each["cause"] == RepeatCause.LOST for each in shard.repeats)
