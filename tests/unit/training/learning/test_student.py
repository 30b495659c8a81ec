"""The student: its histories, and what it learns."""

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.training.collection import guided_actor, random_actor, student_actor
from vitac.training.episodes import joined, play
from vitac.training.learning.critic import Critic, CriticPlan
from vitac.training.learning.student import (
    Histories,
    Student,
    StudentPlan,
    make_histories,
    make_weights,
    student_inputs,
)
from vitac.training.submission.policy import HISTORY_SIZE, values


def test_histories_are_those_that_a_policy_has() -> None:
    histories: list[np.ndarray] = []

    def watched(random: np.random.Generator) -> object:
        actor = random_actor(random)

        def act(moment: object) -> np.ndarray:
            histories.append(moment.history.features())  # type: ignore[attr-defined]
            return actor(moment)  # type: ignore[arg-type]

        return act

    played = play(ToyPeg(), watched, 3, range(6))  # type: ignore[arg-type]
    found = make_histories(played)
    np.testing.assert_array_equal(found.felt, np.array(histories))
    assert found.felt.shape == (len(played.actions), HISTORY_SIZE)
    assert len(found.states) == len(found.felt)
    assert found.turnable.tolist() == np.isin(np.repeat(played.shapes, played.lengths), (0, 2)).tolist()
    assert len(student_inputs(played)) == len(played.felt)


@pytest.mark.slow
def test_learns_from_what_is_felt_what_the_critic_sees() -> None:
    random = np.random.default_rng(0)
    blind = play(ToyPeg(), random_actor, 7, range(150))
    critic = Critic(CriticPlan(networks=2, hidden=32, sweeps=8, epochs=4, batch=64), random)
    critic.learn(joined([blind, play(ToyPeg(), guided_actor, 7, range(150))]), random, lambda _, __: None)
    student = Student(StudentPlan(networks=1, hidden=48, epochs=12, batch=32, rate=5e-3), random)
    losses: list[float] = []
    histories = make_histories(blind)

    def estimate_value(rows: np.ndarray, actions: np.ndarray) -> np.ndarray:
        return critic.log_odds(histories.states[rows], actions)

    student.learn(histories, estimate_value, random, lambda _, loss: losses.append(loss))
    assert losses[-1] < losses[0]
    solved = play(ToyPeg(), student_actor(make_weights(student.state()), 0.0), 8, range(40)).solved.mean()
    assert solved > 0.6 > 2 * play(ToyPeg(), random_actor, 8, range(40)).solved.mean()


def test_best_action_is_the_one_that_the_policy_values_most() -> None:
    student = Student(StudentPlan(networks=2, hidden=8, candidates=32), np.random.default_rng(0))
    felt = np.random.default_rng(1).standard_normal((5, HISTORY_SIZE)).astype(np.float32)
    found = student.best(felt, np.random.default_rng(2))
    drawn = np.random.default_rng(2).uniform(-1, 1, (32, 3)).astype(np.float32)
    weights = make_weights(student.state())
    expected = [drawn[values(weights, history, drawn).argmax()] for history in felt]
    np.testing.assert_array_equal(found, np.array(expected))


def test_continued_student_has_the_same_bits() -> None:
    random = np.random.default_rng(0)
    felt = random.standard_normal((40, HISTORY_SIZE)).astype(np.float32)
    histories = Histories(felt=felt, states=felt[:, :15], turnable=np.ones(40, dtype=np.bool_))
    plan = StudentPlan(networks=1, hidden=8, epochs=2, batch=16)
    first, other = (Student(plan, np.random.default_rng(seed)) for seed in (1, 2))

    def estimate_value(rows: np.ndarray, actions: np.ndarray) -> np.ndarray:
        return np.asarray(actions.sum(axis=2) * felt[rows, :1])

    first.learn(histories, estimate_value, np.random.default_rng(3), lambda _, __: None)
    other.restore(first.state())
    for each in (first, other):
        each.learn(histories, estimate_value, np.random.default_rng(4), lambda _, __: None)
    for name, value in first.state().items():
        np.testing.assert_array_equal(value, other.state()[name])
