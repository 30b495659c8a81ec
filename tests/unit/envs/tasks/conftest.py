import pytest
from fake_scene import FakeScene


@pytest.fixture(autouse=True)
def physics(fake_scenes: list[FakeScene]) -> list[FakeScene]:
    """The stand-in for the physics, in all tests of tasks."""
    return fake_scenes
