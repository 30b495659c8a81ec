from collections.abc import Callable, Iterator

import numpy as np
import pytest
from evaluation_records import make_record
from fake_scene import FakeScene, in_place_of_the_physics
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, EpisodeRecord
from vitac.evaluator.episodes.replay import resimulate
from vitac.evaluator.tracks import find_task

ACTION = (0.25, 0.0, -0.5)


@pytest.fixture
def fake_scenes(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FakeScene]]:
    """Puts FakeScene in the place of the physics."""
    yield from in_place_of_the_physics(monkeypatch)


@pytest.fixture
def recorded(fake_scenes: list[FakeScene]) -> Callable[..., EpisodeRecord]:
    """Records an episode of so many equal actions on a fake of the physics."""

    def record(env_steps: int = 2, number: int = 3, task_name: str = "peg-insertion") -> EpisodeRecord:
        _, task = find_task(task_name)
        episode = task.episodes[number - 1]
        actions = np.tile(np.resize(np.array(ACTION, dtype=np.float32), len(task.actions)), (env_steps, 1))
        played = resimulate(make_environment(task), episode, actions)
        outcome = played.outcome or EpisodeOutcome.ACTIONS_ENDED
        return make_record(
            episode.number,
            outcome,
            env_steps,
            task=task.name,
            shape=episode.shape,
            initial_offset=episode.offset,
            actions=ActionSequence.from_array(actions),
            state_hashes=played.state_hashes,
            infos=played.infos,
        )

    return record
