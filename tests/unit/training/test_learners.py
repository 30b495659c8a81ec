"""What a round learns, and of whom."""

from typing import Any

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.training.collection import ActorKind, guided_actor, random_actor
from vitac.training.episodes import play
from vitac.training.learners import Known, Learners
from vitac.training.learning.critic import CriticPlan
from vitac.training.learning.student import AssessorPlan, StudentPlan
from vitac.training.recipe import Recipe

RECIPE = Recipe(
    task="peg-insertion",
    seed=2,
    critic=CriticPlan(networks=1, hidden=32, sweeps=6, epochs=3),
    assessor=AssessorPlan(networks=1, hidden=32, sweeps=4, epochs=2),
    assessed_from=2,
    assessments=2,
    student=StudentPlan(networks=1, hidden=32, epochs=3),
)


def known(count: int = 30) -> Known:
    return [
        (ActorKind.RANDOM, play(ToyPeg(), random_actor, 7, range(count))),
        (ActorKind.GUIDED, play(ToyPeg(), guided_actor, 7, range(count))),
    ]


def learned(number: int, played: Known, told: list[str]) -> Learners:
    learners = Learners(RECIPE, np.random.default_rng(0))
    learners.learn(played, number, np.random.default_rng(1), lambda who, turn, _: told.append(f"{who} {turn}"))
    return learners


@pytest.mark.parametrize(
    ("number", "expected"),
    [(1, ["critic"] * 6 + ["student"] * 3), (2, ["critic"] * 6 + (["assessor"] * 4 + ["student"] * 3) * 2)],
)
def test_student_learns_of_the_critic_first_and_of_the_assessor_later(number: int, expected: list[str]) -> None:
    told: list[str] = []
    learned(number, known(), told)
    assert [line.split()[0] for line in told] == expected


def test_student_never_learns_from_an_actor_that_knows_the_truth(monkeypatch: pytest.MonkeyPatch) -> None:
    from vitac.training.learning.student import make_histories

    counts: list[int] = []

    def counted(episodes: Any) -> Any:
        counts.append(len(episodes))
        return make_histories(episodes)

    monkeypatch.setattr("vitac.training.learners.make_histories", counted)
    for number in (1, 2):
        learned(number, known(12), [])
    assert counts == [12, 12]


def test_all_that_goes_on_is_in_the_state() -> None:
    told: list[str] = []
    played = known(10)
    first = learned(2, played, told)
    other = Learners(RECIPE, np.random.default_rng(9))
    other.restore(first.state())
    for each in (first, other):
        each.learn(played, 3, np.random.default_rng(2), lambda *_: None)
    for name, value in first.state().items():
        np.testing.assert_array_equal(value, other.state()[name])
