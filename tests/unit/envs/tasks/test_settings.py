"""The fidelity for training: what it changes, that it repeats to the bit, and where it is refused."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import gymnasium
import numpy as np
import pytest
import vitac.envs
from vitac.envs.fem.model.settings import SolverSettings
from vitac.envs.scene.grasped_scene import PhysicsSettings
from vitac.envs.tactile.gel import coarse_gelsight_mini_mesh, gelsight_mini_mesh
from vitac.envs.tactile.markers import MarkerSettings
from vitac.envs.tactile.sensor import CoarseSensor, TactileSensor
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.envs.tasks.settings import (
    ResetOptionsError,
    SettingsError,
    choice,
    choose_shape,
    chosen_shapes,
    either_way,
    nearest,
    numbers,
    read_task_settings,
    refuse_unknown,
    require,
    seeded_generator,
)
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import Task


@dataclass(frozen=True, kw_only=True)
class Settings:
    max_steps: int = 8
    z_step_mm: float = 0.125
    scale: tuple[float, float] = (1.0, 2.0)


def test_overrides_replace_defaults() -> None:
    assert read_task_settings(Settings, {"max_steps": 3, "z_step_mm": 1}) == Settings(max_steps=3, z_step_mm=1)
    assert read_task_settings(Settings, {}) == Settings()


def test_unknown_setting_names_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"Unknown setting 'z_step_size_mm'; did you mean 'z_step_mm'\?"):
        read_task_settings(Settings, {"z_step_size_mm": 0.075})


@pytest.mark.parametrize(
    ("name", "value"), [("max_steps", 2.5), ("max_steps", True), ("z_step_mm", "1"), ("scale", 3.0)]
)
def test_value_of_another_type_is_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=f"'{name}' is .*expected a value of type"):
        read_task_settings(Settings, {name: value})


def test_hint_lists_all_names_where_none_is_near() -> None:
    assert nearest("qqqq", ["beta", "alpha"]) == "expected one of alpha, beta."


def test_require_names_setting_value_and_range() -> None:
    require(True, "a", 1, "anything")
    with pytest.raises(SettingsError, match="Setting 'a' is 1, expected 2 to 3"):
        require(False, "a", 1, "2 to 3")


class Side(StrEnum):
    LEFT = "left"
    RIGHT = "right"


def test_unknown_option_names_the_nearest() -> None:
    with pytest.raises(ResetOptionsError, match=r"Toy-v1 has no reset option 'sidee'; did you mean 'side'\?"):
        refuse_unknown("Toy-v1", {"sidee": "left"}, ("side",))
    refuse_unknown("Toy-v1", {"side": "left", "rng_seed": 1}, ("side",))


def test_choice_is_one_of_a_closed_set() -> None:
    assert choice("Toy-v1", "side", "left", Side) is Side.LEFT
    with pytest.raises(ResetOptionsError, match="Toy-v1: option 'side' is 'up', expected one of left, right"):
        choice("Toy-v1", "side", "up", Side)


@pytest.mark.parametrize("value", [None, 1.0, (1.0,), (1.0, 2.0, 3.0), (1.0, float("nan")), ("a", "b"), (1.0, 2.1)])
def test_numbers_are_so_many_and_in_their_ranges(value: Any) -> None:
    with pytest.raises(ResetOptionsError, match=r"option 'place_mm' is .*, expected two numbers"):
        numbers("Toy-v1", "place_mm", value, either_way(2.0, 2.0), "expected two numbers")
    usable = (1, np.float32(2))
    assert numbers("Toy-v1", "place_mm", usable, either_way(2.0, 2.0), "expected two numbers") == [1.0, 2.0]


@pytest.mark.parametrize("value", [(), (-1,), "seed", 1.5, (0, "1")])
def test_seed_is_of_non_negative_integers(value: Any) -> None:
    with pytest.raises(ResetOptionsError, match="'rng_seed'"):
        seeded_generator("Toy-v1", value)


def test_the_same_seed_gives_the_same_numbers() -> None:
    assert seeded_generator("Toy-v1", (0, 4)).random() == seeded_generator("Toy-v1", [0, 4]).random()
    assert seeded_generator("Toy-v1", (0, 4)).random() != seeded_generator("Toy-v1", (0, 5)).random()


def test_all_shapes_are_drawn_unless_some_are_named() -> None:
    assert chosen_shapes("Toy-v1", Side, None) == (Side.LEFT, Side.RIGHT)
    assert chosen_shapes("Toy-v1", Side, ["right", "left"]) == (Side.LEFT, Side.RIGHT)
    assert chosen_shapes("Toy-v1", Side, ("right", "right")) == (Side.RIGHT,)
    assert chosen_shapes("Toy-v1", None, None) == ()


@pytest.mark.parametrize("names", [(), ("up",), ("left", "up"), "left", (1,)])
def test_shapes_are_some_of_the_closed_set(names: Any) -> None:
    with pytest.raises(SettingsError, match=r"Toy-v1: argument 'shapes' is .*, expected some of left, right"):
        chosen_shapes("Toy-v1", Side, names)


def test_task_without_shapes_draws_none() -> None:
    with pytest.raises(SettingsError, match="expected some of none"):
        chosen_shapes("Toy-v1", None, ("left",))


def test_shapes_are_drawn_equally_often_by_one_number_each() -> None:
    random, other = np.random.default_rng(1), np.random.default_rng(1)
    drawn = [choose_shape("Toy-v1", {}, tuple(Side), random) for _ in range(400)]
    assert drawn == [list(Side)[number] for number in other.integers(2, size=400)]
    assert 150 < drawn.count(Side.LEFT) < 250


TASKS = sorted(vitac.envs.ENVIRONMENTS)
NO_TURN, CENTRE_M = np.eye(3), np.zeros(3)


@pytest.mark.parametrize("env_id", TASKS)
def test_observations_have_the_shapes_of_full_fidelity_and_states_are_other_ones(env_id: str) -> None:
    full, fast = (
        gymnasium.make(env_id, privileged=True, fidelity=name, disable_env_checker=True)
        for name in ("full", "training")
    )
    assert full.observation_space == fast.observation_space
    assert full.unwrapped.mesh_hash() != fast.unwrapped.mesh_hash()  # type: ignore[attr-defined]


def test_an_episode_repeats_to_the_bit_and_is_near_that_of_full_fidelity() -> None:
    def play(fidelity: str) -> tuple[list[str], Any, Any]:
        env = PegInsertionEnv(fidelity=fidelity, privileged=True, observation_keys=("measured_pose", "marker_flow"))
        first, _ = env.reset(options={"rng_seed": (5, 1)})
        hashes = [env.state_hash()]
        observation, *_ = env.step(np.array([0.3, -0.4, 0.5], dtype=np.float32))
        return [*hashes, env.state_hash()], first, observation

    hashes, first, last = play("training")
    again, *_ = play("training")
    exact, exact_first, exact_last = play("full")
    assert hashes == again
    assert set(hashes).isdisjoint(exact)
    assert first["marker_flow"].shape == exact_first["marker_flow"].shape
    np.testing.assert_allclose(last["measured_pose"], exact_last["measured_pose"], atol=0.1)  # mm, degrees
    moved = [np.diff(each["marker_flow"], axis=1)[:, 0] for each in (last, exact_last)]
    assert np.abs(moved[0] - moved[1]).mean() < 0.5  # the same noise: pixels


def test_a_coarse_gel_is_seen_at_the_nodes_of_the_finer_one() -> None:
    coarse, fine, settings = coarse_gelsight_mini_mesh(), gelsight_mini_mesh(), MarkerSettings()
    assert len(coarse.sensing_nodes) < len(fine.sensing_nodes)

    def bent(nodes_m: np.ndarray) -> np.ndarray:
        """Stretch and tilt, which triangles carry exactly."""
        return np.asarray(nodes_m @ np.array([[1.1, 0.02, 0.05], [0.0, 0.9, -0.03], [0.0, 0.0, 1.0]]))

    seen_m = CoarseSensor(coarse, fine, settings).view_m(bent(coarse.rest_position_m), NO_TURN, CENTRE_M)
    expected_m = TactileSensor(fine, settings).view_m(bent(fine.rest_position_m), NO_TURN, CENTRE_M)
    np.testing.assert_allclose(seen_m, expected_m, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"fidelity": "fast"}, "Argument 'fidelity' is 'fast', expected one of full, training."),
        ({"gel": gelsight_mini_mesh()}, "which has a gel of its own; leave out gel, sensor and assets_dir."),
        (
            {"physics": PhysicsSettings(solver=SolverSettings(newton_iterations=50))},
            "which has a solver of its own; leave out yours.",
        ),
    ],
)
def test_refuses_what_does_not_go_together(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        PegInsertionEnv(**{"fidelity": "training", **arguments})


@pytest.mark.parametrize(
    "settings",
    [
        {"settings": {"fidelity": "training"}},
        {"profiles": {"quick": {"reason": "-", "settings": {"fidelity": "training"}}}},
    ],
)
def test_a_ranked_task_refuses_it_by_name(settings: dict[str, Any]) -> None:
    peg = load_track("track_1").tasks["peg-insertion"].model_dump()
    with pytest.raises(ValueError, match=r"settings\.fidelity is 'training', which is for training only; leave it out"):
        Task.model_validate(peg | settings)
