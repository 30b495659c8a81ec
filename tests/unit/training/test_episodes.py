"""Episodes side by side: which observation, step and end belong to which action; and how they are played."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from toy_peg import MAX_STEPS, ToyPeg
from vitac.training.episodes import TRUTHS, ActorInput, Episodes, joined, make_environment, play
from vitac.training.submission.policy import felt_motion


def of_lengths(*lengths: int, solved: tuple[bool, ...] | None = None) -> Episodes:
    """Episodes whose rows are numbered."""
    actions, observations = sum(lengths), sum(lengths) + len(lengths)
    return Episodes(
        lengths=np.array(lengths),
        shapes=np.arange(len(lengths)),
        solved=np.array(solved or (False,) * len(lengths)),
        felt=np.repeat(np.arange(observations, dtype=np.float32)[:, None], 6, axis=1),
        motions=np.zeros((observations, 4), dtype=np.float32),
        truths=np.repeat(np.arange(observations, dtype=np.float32)[:, None], 9, axis=1),
        actions=np.repeat(np.arange(actions, dtype=np.float32)[:, None], 3, axis=1),
    )


def test_an_action_belongs_to_the_observation_before_it() -> None:
    episodes = of_lengths(2, 1, 3)
    assert len(episodes) == 3
    assert episodes.observations.tolist() == [0, 1, 3, 5, 6, 7]
    assert episodes.step.tolist() == [0, 1, 0, 0, 1, 2]
    assert len(episodes.truths) == episodes.observations[-1] + 2, "the last observation comes after the last action"


def test_the_last_action_of_an_episode_is_the_one_that_may_reach_the_goal() -> None:
    episodes = of_lengths(2, 1, 3, solved=(True, False, True))
    assert episodes.last.tolist() == [False, True, True, False, False, True]
    assert episodes.reached.tolist() == [False, True, False, False, False, True]


def test_one_episode_of_one_step_is_enough() -> None:
    episodes = of_lengths(1, solved=(True,))
    assert (episodes.observations.tolist(), episodes.step.tolist()) == ([0], [0])
    assert (episodes.last.tolist(), episodes.reached.tolist()) == ([True], [True])


def test_joined_episodes_are_those_of_the_parts_in_their_order() -> None:
    first, second = of_lengths(2, 1), of_lengths(3, solved=(True,))
    both = joined([first, second])
    assert both.lengths.tolist() == [2, 1, 3]
    assert both.solved.tolist() == [False, False, True]
    assert both.observations.tolist() == of_lengths(2, 1, 3).observations.tolist()
    for name, array in both.arrays().items():
        assert array.dtype == first.arrays()[name].dtype, name
        np.testing.assert_array_equal(array[len(first.arrays()[name]) :], second.arrays()[name])


def test_all_fields_are_among_the_arrays_of_a_file() -> None:
    episodes = of_lengths(1)
    assert list(episodes.arrays()) == [field.name for field in fields(Episodes)]
    again = Episodes(**episodes.arrays())
    assert again.actions is episodes.actions


def never(_: np.random.Generator) -> Callable[[ActorInput], np.ndarray]:
    return lambda _: np.zeros(3, dtype=np.float32)


def test_played_episodes_hold_what_was_observed_done_and_true() -> None:
    moments: list[ActorInput] = []

    def watched(random: np.random.Generator) -> Callable[[ActorInput], np.ndarray]:
        def act(moment: ActorInput) -> np.ndarray:
            moments.append(moment)
            return random.uniform(-0.1, 0.1, 3).astype(np.float32)

        return act

    played = play(ToyPeg(), watched, 5, range(3))
    toy = ToyPeg()
    first, _ = toy.reset(options={"rng_seed": (5, 0)})
    assert played.shapes[0] == toy.shape
    np.testing.assert_array_equal(played.felt[0], felt_motion(first["marker_flow"]))
    np.testing.assert_array_equal(played.truths[0], np.concatenate([first[key] for key in TRUTHS]))
    np.testing.assert_array_equal(played.motions[0], first["relative_motion"])
    after, _, _, _, _ = toy.step(played.actions[0])
    np.testing.assert_array_equal(played.truths[1], np.concatenate([after[key] for key in TRUTHS]))
    assert [moment.step for moment in moments] == played.step.tolist()
    np.testing.assert_array_equal([moment.truth for moment in moments], played.truths[played.observations])
    assert {array.dtype for name, array in played.arrays().items() if name in ("felt", "motions", "truths")} == {
        np.dtype(np.float32)
    }


def test_an_episode_ends_at_success_or_when_its_steps_are_used_up() -> None:
    played = play(ToyPeg(), never, 5, range(40))
    toys = []
    for number in range(40):
        toy = ToyPeg()
        toy.reset(options={"rng_seed": (5, number)})
        toys.append(bool(np.abs(toy.offset[:2]).max() < 2.0))
    assert played.solved.tolist() == toys
    assert 0 < sum(toys) < 40
    assert played.lengths.tolist() == [1 if solved else MAX_STEPS for solved in toys]


def test_an_episode_is_the_same_whatever_was_played_before() -> None:
    from vitac.training.collection import random_actor

    alone, among = play(ToyPeg(), random_actor, 5, [7]), play(ToyPeg(), random_actor, 5, [3, 7])
    for name, array in alone.arrays().items():
        np.testing.assert_array_equal(array, among.arrays()[name][-len(array) :])
    assert not np.array_equal(alone.actions[0], play(ToyPeg(), random_actor, 6, [7]).actions[0])


def test_environment_tells_the_truth_and_nothing_that_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    class Made:
        unwrapped = "the environment"

    def make(env_id: str, **arguments: Any) -> Made:
        asked.update(arguments, env_id=env_id)
        return Made()

    monkeypatch.setattr("gymnasium.make", make)
    assert make_environment(render_mode=None) == "the environment"
    assert asked["env_id"] == "ViTac/PegInsertion-v1"
    assert asked["privileged"] is True
    assert set(asked["observation_keys"]) == {"marker_flow", "relative_motion", "shape", "gt_offset", "measured_pose"}
    assert "render_mode" in asked
