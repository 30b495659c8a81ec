"""The critic: what it is shown and what it learns."""

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.training.collection import critic_actor, guided_actor, random_actor
from vitac.training.episodes import Episodes, joined, play
from vitac.training.learning.critic import STATE_SIZE, Critic, CriticPlan, stack_states, transitions

PLAN = CriticPlan(networks=2, hidden=32, sweeps=4, epochs=2, batch=64)


def episodes(count: int = 60) -> Episodes:
    return joined([play(ToyPeg(), actor, 7, range(count)) for actor in (random_actor, guided_actor)])


def test_state_has_the_offset_in_the_grippers_own_axes_and_the_shape() -> None:
    truth = np.array([[4.0, 0.0, 90.0, 4, 0, 19.875, 0, 0, 90]], dtype=np.float32)
    (state,) = stack_states(truth, np.array([2]), np.array([0]))
    assert state.shape == (STATE_SIZE,)
    assert state[:5] == pytest.approx([1.0, 0.0, 90 / 8, 0.0, -1.0], abs=1e-6)
    assert state[5:].tolist() == pytest.approx([0] * 7 + [0, 0, 1])


def test_transitions_join_each_action_with_what_came_of_it() -> None:
    played = episodes(5)
    known = transitions(played)
    assert len(known.actions) == len(played.actions) == played.lengths.sum()
    assert known.last.sum() == len(played)
    assert known.reached.sum() == played.solved.sum()
    assert (known.after[:, 11] - known.before[:, 11]).tolist() == pytest.approx([1 / 8] * len(known.actions))
    inside = ~known.last
    np.testing.assert_array_equal(known.after[inside], known.before[np.flatnonzero(inside) + 1])
    assert known.turnable.tolist() == np.isin(np.repeat(played.shapes, played.lengths), (0, 2)).tolist()


def test_learns_to_solve_what_random_motions_do_not() -> None:
    random = np.random.default_rng(0)
    critic = Critic(CriticPlan(networks=2, hidden=32, sweeps=8, epochs=4, batch=64), random)
    losses: list[float] = []
    critic.learn(episodes(150), random, lambda _, loss: losses.append(loss))
    assert len(losses) == 8
    solved = play(ToyPeg(), critic_actor(critic, 0.0), 8, range(40)).solved.mean()
    assert solved > 0.75 > 2 * play(ToyPeg(), random_actor, 8, range(40)).solved.mean()


def test_the_lowest_of_the_networks_counts() -> None:
    critic = Critic(PLAN, np.random.default_rng(1))
    states = np.random.default_rng(2).standard_normal((4, STATE_SIZE)).astype(np.float32)
    actions = np.zeros((1, 3), dtype=np.float32)
    singles = []
    for number in range(2):
        state = {
            f"0.{name.partition('.')[2]}": value
            for name, value in critic.state().items()
            if name.startswith(f"{number}.")
        }
        single = Critic.from_state(CriticPlan(networks=1, hidden=32), state)
        singles.append(single.log_odds(states, actions))
    np.testing.assert_array_equal(critic.log_odds(states, actions), np.minimum(*singles))


def test_continued_critic_has_the_same_bits() -> None:
    played = episodes(20)
    critic = Critic(PLAN, np.random.default_rng(3))
    critic.learn(played, np.random.default_rng(4), lambda _, __: None)
    again = Critic.from_state(PLAN, critic.state())
    for each in (critic, again):
        each.learn(played, np.random.default_rng(5), lambda _, __: None)
    for name, value in critic.state().items():
        np.testing.assert_array_equal(value, again.state()[name])
