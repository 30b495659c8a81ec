from collections.abc import Iterator

import pytest
from fake_scene import FakeScene


@pytest.fixture
def fake_scenes(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[FakeScene]]:
    """Puts FakeScene in the place of the physics and gives the scenes that were built."""
    FakeScene.built.clear()
    monkeypatch.setattr(FakeScene, "bulge_m", 0.0)
    monkeypatch.setattr(FakeScene, "statuses", ())
    monkeypatch.setattr("vitac.envs.scene.grasped_scene.Scene", FakeScene)
    yield FakeScene.built
    FakeScene.built.clear()
