from collections.abc import Callable, Iterator

import numpy as np
import pytest
from fake_scene import FakeScene, in_place_of_the_physics
from resimulated_record import resimulated_record
from vitac.evaluator.episodes.records import EpisodeRecord
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
        action = np.resize(np.array(ACTION, dtype=np.float32), len(task.actions))
        return resimulated_record(task, number, np.tile(action, (env_steps, 1)))

    return record
