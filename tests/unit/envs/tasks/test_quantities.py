"""Quantities that are drawn for every episode from ranges that a track file states."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.assets import Meshes
from vitac.envs.tactile.camera import CameraMount
from vitac.envs.tactile.markers import MountedMarkerSettings
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv, PegInsertionSettings
from vitac.envs.tasks.quantities import (
    Quantity,
    Randomization,
    draw_quantities,
    drawn_settings,
    find_randomization,
    with_quantities,
)
from vitac.envs.tasks.settings import SettingsError

ENV_TYPES = [PegInsertionEnv, LockOpeningEnv, FusionInsertionEnv]
DRAWS = {"gel_modulus_kpa": (200.0, 400.0), "marker_noise_px": (1.0, 2.0)}


def drawn(env: Any, number: int) -> dict[str, float]:
    _, info = env.reset(options={"rng_seed": (3, number)})
    return dict(info["draws"])


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_every_episode_has_values_of_its_own_within_the_ranges(env_type: Any, physics: list[FakeScene]) -> None:
    env = env_type(draws=DRAWS, observation_keys=())
    found = [drawn(env, number) for number in range(20)]
    for name, (low, high) in DRAWS.items():
        values = [episode[name] for episode in found]
        assert len(set(values)) == 20
        assert low <= min(values) < low + 0.3 * (high - low)
        assert high - 0.3 * (high - low) < max(values) <= high
    assert [scene.gels[0].youngs_modulus_pa for scene in physics] == [1e3 * draw["gel_modulus_kpa"] for draw in found]


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_same_seed_has_the_same_draw_in_another_environment_and_order(env_type: Any) -> None:
    first, second = env_type(draws=DRAWS, observation_keys=()), env_type(draws=DRAWS, observation_keys=())
    forwards = [drawn(first, number) for number in (1, 2, 3)]
    assert [drawn(second, number) for number in (3, 2, 1)] == forwards[::-1]


def test_another_quantity_leaves_the_draws_of_the_others_as_they_are() -> None:
    both, one = ({name: DRAWS[name] for name in names} for names in (DRAWS, ["marker_noise_px"]))
    seeds = [(7, number) for number in range(5)]
    values = [[draw_quantities(draws, np.random.default_rng(seed)) for seed in seeds] for draws in (both, one)]
    assert [draw["marker_noise_px"] for draw in values[0]] == [draw["marker_noise_px"] for draw in values[1]]


def test_numbers_that_a_task_draws_itself_are_those_without_draws() -> None:
    """The start, and so the whole 2025 list, does not move when quantities are drawn."""
    plain, drawing = PegInsertionEnv(privileged=True), PegInsertionEnv(privileged=True, draws=DRAWS)
    (first, info), (second, _) = (env.reset(seed=4) for env in (plain, drawing))
    assert np.array_equal(first["gt_offset"], second["gt_offset"])
    assert "draws" not in info


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_no_observation_holds_a_draw(env_type: Any) -> None:
    env = env_type(draws=DRAWS, privileged=True)
    assert set(env.observation_space.spaces) == {entry.name for entry in env.task.observables}


@pytest.mark.parametrize(
    ("draws", "message"),
    [
        ({"gel_modulus": (1, 2)}, r"no quantity 'gel_modulus' to draw; did you mean 'gel_modulus_kpa'\?"),
        (
            {"marker_loss": (0.5, 0.1)},
            r"Draw 'marker_loss' is \[0.5, 0.1\], expected two numbers from 0 to 0.9 1, rising",
        ),
        ({"marker_loss": (0.0, 2.0)}, "expected two numbers from 0 to 0.9"),
        ({"marker_loss": (0.0,)}, "expected two numbers"),
        ({"marker_loss": (0.0, float("nan"))}, "expected two numbers"),
    ],
)
def test_refuses_unknown_quantities_and_bad_ranges(draws: Any, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        PegInsertionEnv(draws=draws)


def test_friction_by_materials_is_refused_under_a_model_without_materials() -> None:
    env = PegInsertionEnv(draws={"part_friction": (0.2, 0.4)})
    with pytest.raises(SettingsError, match=r"contact model challenge-2025; set contact_model: arena-2"):
        env.reset(seed=1)


def test_mesh_hash_covers_the_ranges() -> None:
    hashes = {PegInsertionEnv(draws=draws).mesh_hash() for draws in ({}, DRAWS, {"marker_loss": (0.0, 0.1)})}
    assert len(hashes) == 3


@pytest.mark.parametrize("env_type", ENV_TYPES)
def test_every_quantity_changes_the_settings_at_both_ends_of_its_range(env_type: Any) -> None:
    settings = env_type(contact_model="arena-2").settings
    quantities: tuple[Quantity, ...] = env_type.task.quantities
    for quantity in quantities:
        ends = [with_quantities(settings, quantities, {quantity.name: value}) for value in quantity.range]
        assert ends[0] != ends[1], quantity.name
        assert quantity.range[0] <= quantity.nominal <= quantity.range[1]


def test_each_sensor_sees_through_its_own_camera_and_nothing_else_changes() -> None:
    settings = PegInsertionEnv(contact_model="arena-2").settings
    drawn = {"left_shift_u_px": 3.0, "left_turn_deg": 1.0, "right_distortion": 0.02}
    markers = with_quantities(settings, PegInsertionEnv.task.quantities, drawn).markers
    assert isinstance(markers, MountedMarkerSettings)
    sensors = Meshes(is_arena=True).sensors(markers)
    assert [sensor.mount for sensor in sensors] == [
        CameraMount(shift_u_px=3.0, turn_deg=1.0), CameraMount(distortion=0.02)
    ]  # fmt: skip
    assert [sensor.mount for sensor in Meshes(is_arena=True).sensors(settings.markers)] == [None, None]
    ideal = MountedMarkerSettings(**asdict(settings.markers))
    assert markers == replace(ideal, left=markers.left, right=markers.right)


SEED = {"rng_seed": (3, 1)}


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
