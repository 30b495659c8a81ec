"""What the base adds to every task: parts that are composed from outside."""

from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.observable import Observable
from vitac.envs.tactile.gel import GelCells, structured_gel
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv

START = {"shape": "cuboid", "offset_mm_deg": (1.0, 0.0, 0.0), "rng_seed": (0, 1)}


class TopCamera:
    """Sees the height of the held part as a picture of one pixel, and counts how often it is asked."""

    def __init__(self) -> None:
        self.pictures = 0
        self.observables: tuple[Observable[Any], ...] = (
            Observable(
                name="top_picture",
                shape=(1, 1, 3),
                dtype="uint8",
                unit="mm",
                meaning="Height of the held part, three times.",
                read=lambda scene, _: self._picture(scene),
            ),
        )

    def _picture(self, scene: Any) -> np.ndarray:
        self.pictures += 1
        top_m = scene.grasped.held_vertices_m(np.arange(4))[:, 2].max()
        return np.full((1, 1, 3), round(top_m * 1e3))


@pytest.fixture(autouse=True)
def physics(fake_scenes: list[FakeScene]) -> list[FakeScene]:
    return fake_scenes


def test_a_camera_is_added_without_touching_the_task() -> None:
    camera = TopCamera()
    env = PegInsertionEnv(observables=camera.observables)
    observation, _ = env.reset(options=START)
    assert list(observation) == ["relative_motion", "marker_flow", "top_picture"]
    assert observation["top_picture"].dtype == np.uint8
    assert observation["top_picture"].tolist() == [[[20, 20, 20]]]
    assert observation in env.observation_space
    env.step(np.zeros(3, dtype=np.float32))
    assert camera.pictures == 2


def test_an_added_observable_changes_nothing_of_the_others() -> None:
    plain, _ = PegInsertionEnv().reset(options=START)
    seen, _ = PegInsertionEnv(observables=TopCamera().observables).reset(options=START)
    assert all(np.array_equal(plain[key], seen[key]) for key in plain)


def test_another_gel_is_added_without_touching_the_task(physics: list[FakeScene]) -> None:
    gel = structured_gel(name="coarse", cells=GelCells(x=4, y=4))
    env = PegInsertionEnv(gel=gel)
    env.reset(options=START)
    assert [body.mesh for body in physics[0].gels] == [gel, gel]
    assert env.mesh_hash() != PegInsertionEnv().mesh_hash()
