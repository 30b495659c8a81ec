"""Settings that are drawn for every episode."""

from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.envs.tasks.peg_insertion.settings import PegInsertionSettings
from vitac.envs.tasks.randomization import Randomization, drawn_settings, find_randomization
from vitac.envs.tasks.settings import SettingsError

ENV_TYPES = [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv]
SEED = {"rng_seed": (3, 1)}


@pytest.fixture(autouse=True)
def physics(fake_scenes: list[FakeScene]) -> list[FakeScene]:
    return fake_scenes


def frictions(scene: FakeScene) -> tuple[float, float, float]:
    """Of gel, held part and fixed part."""
    return scene.gels[0].friction, scene.bodies[0].friction, scene.bodies[1].friction


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_every_episode_has_its_own_within_the_published_ranges(env_type: Any, physics: list[FakeScene]) -> None:
    env = env_type(randomization="challenge", observation_keys=())
    for number in range(20):
        env.reset(options={"rng_seed": (9, number)})
    found = np.array([frictions(scene) for scene in physics])
    assert len(np.unique(found, axis=0)) == 20
    held = (0.2, 1.0) if env_type is LockOpeningEnv else (4.0, 15.0)
    for column, (low, high) in zip(found.T, [(50.0, 125.0), held, (0.0, 1.0)], strict=True):
        assert low <= column.min() < low + 0.3 * (high - low)
        assert high - 0.3 * (high - low) < column.max() <= high


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_the_episodes_generator_decides(env_type: Any, physics: list[FakeScene]) -> None:
    for _ in range(2):
        env_type(randomization="challenge", observation_keys=()).reset(options=SEED)
    assert frictions(physics[0]) == frictions(physics[1])


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_start_is_that_of_the_same_episode_without(env_type: Any, physics: list[FakeScene]) -> None:
    for randomization in ("none", "challenge"):
        env_type(randomization=randomization, observation_keys=()).reset(options=SEED)
    plain, drawn = (scene.bodies[0] for scene in physics)
    np.testing.assert_array_equal(plain.translation_m, drawn.translation_m)
    np.testing.assert_array_equal(plain.rotation, drawn.rotation)
    assert plain.mesh is drawn.mesh


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_nothing_is_drawn_unless_asked_for(env_type: Any, physics: list[FakeScene]) -> None:
    for number in range(2):
        env_type(observation_keys=()).reset(options={"rng_seed": (9, number)})
    assert frictions(physics[0]) == frictions(physics[1])


def test_fusion_draws_the_same_by_its_setting(physics: list[FakeScene]) -> None:
    FusionInsertionEnv(random_physics=True, observation_keys=()).reset(options=SEED)
    FusionInsertionEnv(randomization="challenge", observation_keys=()).reset(options=SEED)
    assert frictions(physics[0]) == frictions(physics[1])


def test_draws_come_in_the_order_of_the_ranges() -> None:
    ranges = {"physics.gel_friction": (10.0, 20.0), "peg_friction": (1.0, 2.0)}
    drawn = drawn_settings(PegInsertionSettings(), ranges, np.random.default_rng(4))
    random = np.random.default_rng(4)
    assert drawn.physics.gel_friction == random.uniform(10.0, 20.0)
    assert drawn.peg_friction == random.uniform(1.0, 2.0)
    assert drawn.physics.youngs_modulus_pa == PegInsertionSettings().physics.youngs_modulus_pa
    assert drawn.max_steps == PegInsertionSettings().max_steps


def test_settings_of_the_environment_stay_as_they_were() -> None:
    env = PegInsertionEnv(randomization="challenge", observation_keys=())
    env.reset(options=SEED)
    assert env.settings == PegInsertionSettings()
    assert env.mesh_hash() == PegInsertionEnv().mesh_hash()


@pytest.mark.parametrize("value", ["published", "", None, True])
def test_unknown_randomization_is_refused(value: Any) -> None:
    with pytest.raises(SettingsError, match=r"'randomization' is .* expected one of none, challenge"):
        find_randomization(value)


def test_known_randomizations() -> None:
    assert [find_randomization(each) for each in ("none", "challenge")] == list(Randomization)
