from collections.abc import Iterator

import pytest
from fake_scene import FakeScene, in_place_of_the_physics


@pytest.fixture
def fake_scenes(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FakeScene]]:
    """Puts FakeScene in the place of the physics and gives the scenes that were built."""
    yield from in_place_of_the_physics(monkeypatch)
