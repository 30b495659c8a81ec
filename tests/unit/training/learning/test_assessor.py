"""The assessor: how good the student is after an action, by what the student does next."""

import numpy as np
from toy_peg import ToyPeg
from vitac.training.collection import guided_actor, random_actor
from vitac.training.episodes import Episodes, joined, play
from vitac.training.learning.critic import STATE_SIZE, transitions
from vitac.training.learning.student import Assessed, Assessor, AssessorPlan, assessed, student_inputs
from vitac.training.submission.policy import HISTORY_SIZE

PLAN = AssessorPlan(networks=1, hidden=32, sweeps=6, epochs=4, batch=64, rate=3e-3)


def episodes(count: int = 60) -> Episodes:
    return joined([play(ToyPeg(), actor, 7, range(count)) for actor in (random_actor, guided_actor)])


def towards_the_hole(known: Assessed, played: Episodes) -> np.ndarray:
    """What a student would do next that goes straight to the hole."""
    offset = played.truths[played.observations + 1, :3]
    return np.clip(-offset / [2.0, 2.0, 4.0], -1, 1).astype(np.float32)


def mean_value(assessor: Assessor, known: Assessed) -> float:
    return float(assessor.log_odds(known.before.inputs, known.before.actions[:, None]).mean())


def test_transitions_have_what_the_student_is_told_before_and_after() -> None:
    played = episodes(6)
    known, told, truths = assessed(played), student_inputs(played), transitions(played)
    assert known.before.inputs.shape == (len(played.actions), STATE_SIZE + HISTORY_SIZE)
    np.testing.assert_array_equal(known.before.inputs[:, :STATE_SIZE], truths.before)
    np.testing.assert_array_equal(known.before.inputs[:, STATE_SIZE:], told[played.observations])
    np.testing.assert_array_equal(known.after[:, STATE_SIZE:], known.felt)
    inside = np.flatnonzero(~known.last)
    np.testing.assert_array_equal(known.after[inside], known.before.inputs[inside + 1])
    assert known.reached.sum() == played.solved.sum()


def test_a_student_that_goes_on_well_is_assessord_better() -> None:
    played = episodes()
    known = assessed(played)
    well = towards_the_hole(known, played)
    values, losses = [], []
    for following in (well, -well):
        assessor = Assessor(PLAN, np.random.default_rng(0))
        assessor.learn(known, following, np.random.default_rng(1), lambda _, loss: losses.append(loss))
        values.append(mean_value(assessor, known))
    assert len(losses) == 2 * PLAN.sweeps
    assert values[0] > values[1] + 0.3


def test_continued_assessor_has_the_same_bits() -> None:
    played = episodes(20)
    known = assessed(played)
    following = towards_the_hole(known, played)
    first, other = (Assessor(PLAN, np.random.default_rng(seed)) for seed in (0, 1))
    first.learn(known, following, np.random.default_rng(2), lambda _, __: None)
    other.restore(first.state())
    for each in (first, other):
        each.learn(known, following, np.random.default_rng(3), lambda _, __: None)
    for name, value in first.state().items():
        np.testing.assert_array_equal(value, other.state()[name])
