"""Tasks under a contact model chosen by name."""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from environment_ids import ENV_IDS
from vitac.envs.fem.contact.forces import empty_memory
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.scene.grasped_scene import PhysicsSettings
from vitac.envs.tasks.settings import SettingsError
from vitac.evaluator.tracks import list_tracks, load_track

OF_ARENA = [
    *("ViTac/Assembly-v1", "ViTac/Explore-v1", "ViTac/InHandTurn-v1", "ViTac/MovingHole-v1", "ViTac/Slip-v1"),
    *("ViTac/SoftPlug-v1", "ViTac/CableEnd-v1"),
]


def made(env_id: str, **arguments: Any) -> Any:
    return gymnasium.make(env_id, disable_env_checker=True, **arguments).unwrapped


@pytest.mark.parametrize("env_id", [each for each in ENV_IDS if each not in OF_ARENA])
def test_the_challenge_model_is_the_default_and_the_mesh_hash_tells_models_apart(env_id: str) -> None:
    default, named, ours = (made(env_id, **kind).mesh_hash() for kind in ({}, *map(_named, ContactModel)))
    assert default == named != ours


@pytest.mark.parametrize("env_id", OF_ARENA)
def test_a_task_of_another_model_has_that_one_alone(env_id: str) -> None:
    assert made(env_id).mesh_hash() == made(env_id, contact_model="arena-2").mesh_hash()
    with pytest.raises(SettingsError, match="the task's physics, or those given, have arena-2; leave it out"):
        made(env_id, contact_model="challenge-2025")


def _named(model: ContactModel) -> dict[str, str]:
    return {"contact_model": str(model)}


def test_unknown_model_is_refused_by_name() -> None:
    with pytest.raises(SettingsError, match="'contact_model' is 'coulomb', expected one of challenge-2025, arena-2"):
        made("ViTac/PegInsertion-v1", contact_model="coulomb")


def test_track_files_name_the_contact_model_that_their_environments_have() -> None:
    tasks = [task for name in list_tracks() for task in load_track(name).tasks.values()]
    assert {task.contact_model for task in tasks} == {None, *map(str, ContactModel)}
    for task in tasks:
        if task.contact_model is not None:
            env = made(task.env_id, **task.environment_arguments)
            assert env.settings.physics.contact.model == task.contact_model


def test_model_that_contradicts_the_physics_is_refused() -> None:
    ours = made("ViTac/PegInsertion-v1", contact_model="arena-2").settings.physics
    with pytest.raises(SettingsError, match="or those given, have arena-2"):
        made("ViTac/PegInsertion-v1", contact_model="challenge-2025", physics=ours)
    assert made("ViTac/PegInsertion-v1", contact_model="arena-2", physics=ours).settings.physics is ours
    assert PhysicsSettings().contact.model == "challenge-2025"


def states_after(env: Any, actions: np.ndarray) -> list[str]:
    """State hash after each of the actions."""
    hashes = []
    for action in actions:
        env.step(action)
        hashes.append(env.state_hash())
    return hashes


@pytest.mark.parametrize("env_id", ["ViTac/PegInsertion-v1", "ViTac/LockOpening-v1", "ViTac/Slip-v1"])
def test_episode_under_our_model_resumed_in_the_middle_has_the_bits_of_an_uninterrupted_one(env_id: str) -> None:
    """A copy that forgets what friction remembers has not, though its nodes stand and move the same."""
    uninterrupted, resumed = made(env_id, contact_model="arena-2"), made(env_id, contact_model="arena-2")
    actions = np.random.default_rng(1).uniform(-0.5, 0.5, (4, *resumed.action_space.shape)).astype(np.float32)
    for env in (uninterrupted, resumed):
        env.reset(seed=3)
    expected = states_after(uninterrupted, actions)
    assert states_after(resumed, actions[:2]) == expected[:2]
    snapshot = resumed.snapshot()
    states_after(resumed, -actions[2:])
    resumed.restore(snapshot)
    assert states_after(resumed, actions[2:]) == expected[2:]
    forgotten = replace(snapshot.grasp, physics=snapshot.grasp.physics._replace(memory=empty_memory()))
    resumed.restore(replace(snapshot, grasp=forgotten))
    assert states_after(resumed, actions[2:])[-1] != expected[-1]


def test_actions_played_again_in_another_environment_reach_the_same_states() -> None:
    """As playbacks and re-simulated logs do: what contacts remember follows from the actions alone."""
    hashes = []
    for _ in range(2):
        env = made("ViTac/LockOpening-v1", contact_model="arena-2")
        env.reset(seed=3)
        states = []
        for sign in (1.0, -1.0, 0.5):
            env.step(np.full(env.action_space.shape, sign, dtype=np.float32))
            states.append(env.state_hash())
        assert len(env.scene._scene._memory.pairs) > 0
        hashes.append(states)
    assert hashes[0] == hashes[1]
    assert len(set(hashes[0])) == 3


def test_mirrored_episode_under_our_model_moves_the_other_sensor_as_much() -> None:
    """The mesh of arena-2 is symmetric; that of the challenge is so only to a few percent."""
    env, random = made("ViTac/PegInsertion-v1", contact_model="arena-2"), np.random.default_rng(1)
    offset, actions = random.uniform(-4, 4, 3), random.uniform(-0.5, 0.5, (2, 3)).astype(np.float32)
    motions = []
    for mirror in (np.array([1, 1, 1], dtype=np.float32), np.array([1, -1, -1], dtype=np.float32)):
        env.reset(seed=0, options={"shape": "cuboid", "offset_mm_deg": (offset * mirror).tolist()})
        for action in actions:
            env.step(action * mirror)
        motions.append(env.scene.surface_diff_m())
    assert motions[0] == pytest.approx(motions[1][::-1], rel=0.005)
