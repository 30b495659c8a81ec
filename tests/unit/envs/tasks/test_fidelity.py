"""The fidelity for training: what it changes, that it repeats to the bit, and where it is refused."""

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
from vitac.envs.tasks.settings import SettingsError
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import Task

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
