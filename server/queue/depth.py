"""How much work there is for workers; what starts and ends machines asks."""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from ..database.models import Playback, Shard
from ..database.states import OPEN_SHARD_STATES, PlaybackState


def count_open_work(session: Session) -> int:
    """Return how many shards and playbacks wait or run."""
    shards = select(func.count()).where(Shard.state.in_(OPEN_SHARD_STATES)).scalar_subquery()
    open_playbacks = Playback.state.in_((PlaybackState.QUEUED, PlaybackState.RUNNING))
    playbacks = select(func.count()).where(open_playbacks).scalar_subquery()
    count: int = session.scalars(select(shards + playbacks)).one()
    return count
