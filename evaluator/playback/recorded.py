"""What a record says of an episode that is played again: its start, and the states that must come back."""

from vitac.envs.errors import VitacError

from ..episodes.records import EpisodeRecord
from ..tracks import Episode, Task


class StatesDiffer(VitacError):
    """A re-simulated state is not the recorded one, so what would be shown is not what was scored."""


def find_start(task: Task, record: EpisodeRecord, list_seed: int | None = None) -> Episode:
    """Return where a recorded episode started, in the public list or in one with another seed."""
    listed = task.episode_list
    return Episode(
        number=record.episode,
        shape=record.shape,
        offset=record.initial_offset,
        offset_option=listed.offset_option,
        list_seed=listed.list_seed if list_seed is None else list_seed,
    )


def require_same_state(found: str, record: EpisodeRecord, env_step: int) -> None:
    """Compare a state hash with that of the record.

    Raises:
        StatesDiffer: it is another one, or the record ends before.
    """
    if env_step >= len(record.state_hashes) or found != record.state_hashes[env_step]:
        raise StatesDiffer(
            f"The state after env step {env_step} is not the recorded one: the episode was recorded with another "
            "evaluator or on another platform class, so it cannot be shown here."
        )


def require_same_end(env_steps: int, record: EpisodeRecord) -> None:
    """Compare where an episode has ended with its record.

    Raises:
        StatesDiffer: it ended elsewhere.
    """
    if env_steps != record.env_steps:
        raise StatesDiffer(f"Expected {record.env_steps} env steps as recorded, got {env_steps}.")
