"""Records of episodes that were played with given actions."""

import numpy as np
from evaluation_records import make_record
from numpy.typing import NDArray
from vitac.evaluator.episodes.episode import make_environment, resimulate
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.tracks import Task


def resimulated_record(task: Task, number: int, actions: NDArray[np.float32]) -> EpisodeRecord:
    """Returns what an episode of a task's list comes to with these actions, one per env step."""
    episode = task.episodes[number - 1]
    played = resimulate(make_environment(task), episode, actions)
    return make_record(
        number,
        played.outcome or EpisodeOutcome.ACTIONS_ENDED,
        len(actions),
        task=task.name,
        shape=episode.shape,
        initial_offset=episode.offset,
        actions=ActionSequence.from_array(actions),
        state_hashes=played.state_hashes,
        infos=played.infos,
    )
