"""The fixed cut of an episode list into shards: the unit of queue work and of resuming."""

from collections.abc import Iterable
from dataclasses import dataclass

from vitac.errors import VitacError

from .definition import Episode, Task


class UnknownEpisodes(VitacError):
    """Episodes were asked for that the list does not have."""


@dataclass(frozen=True, kw_only=True)
class ShardEpisodes:
    """Neighbouring episodes of a list. `index` counts from 0 in the cut of the whole list."""

    index: int
    episodes: tuple[Episode, ...]

    @property
    def numbers(self) -> frozenset[int]:
        """Numbers of its episodes."""
        return frozenset(episode.number for episode in self.episodes)


def cut(task: Task, episodes: Iterable[int] | None = None) -> tuple[ShardEpisodes, ...]:
    """Cut the task's list into shards of `task.shard_size`, always at the same places.

    Args:
        task: whose list.
        episodes: numbers to keep; all by default. A shard without any of them is omitted.

    Raises:
        UnknownEpisodes: a number is not in the list, or none is asked for.
    """
    listed = frozenset(episode.number for episode in task.episodes)
    wanted = listed if episodes is None else frozenset(episodes)
    if not wanted or not wanted <= listed:
        got = ", ".join(map(str, sorted(wanted - listed)[:5])) or "none"
        raise UnknownEpisodes(f"Expected episodes of {task.name} from 1 to {len(listed)}, got {got}.")
    starts = range(0, len(task.episodes), task.shard_size)
    pieces = (task.episodes[start : start + task.shard_size] for start in starts)
    kept = (tuple(episode for episode in piece if episode.number in wanted) for piece in pieces)
    return tuple(ShardEpisodes(index=index, episodes=piece) for index, piece in enumerate(kept) if piece)
