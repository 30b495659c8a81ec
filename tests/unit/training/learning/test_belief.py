"""What can be told of the offset from what a policy knows."""

import numpy as np
from toy_peg import ToyPeg
from vitac.training.collection import guided_actor, random_actor
from vitac.training.episodes import Episodes, play
from vitac.training.learning.student import OFFSET, Student, StudentPlan, fit_belief, make_weights, student_inputs
from vitac.training.submission.policy import HISTORY_SIZE, belief_inputs

HIDDEN = 16


def weights() -> dict[str, np.ndarray]:
    return make_weights(Student(StudentPlan(networks=2, hidden=HIDDEN), np.random.default_rng(0)).state())


def errors(found: np.ndarray, episodes: Episodes) -> np.ndarray:
    looked = episodes.observations
    return np.asarray(
        belief_inputs(weights(), student_inputs(episodes)[looked]) @ found - episodes.truths[looked, OFFSET],
    )


def test_an_offset_that_is_felt_is_believed_on_starts_that_taught_nothing() -> None:
    taught, fresh = (play(ToyPeg(), random_actor, 7, numbers) for numbers in (range(200), range(900, 960)))
    found = fit_belief(weights(), taught)
    assert found.shape == (HISTORY_SIZE + 2 * HIDDEN + 1, 3)
    assert found.dtype == np.float32
    spread = fresh.truths[fresh.observations, OFFSET].std(axis=0)
    left = np.sqrt((errors(found, fresh) ** 2).mean(axis=0))
    assert (left < [0.6, 0.6, 0.6] * spread).all()


def test_theta_is_known_once_a_motion_has_told_it() -> None:
    played = play(ToyPeg(), random_actor, 3, range(200))
    wrong = np.abs(errors(fit_belief(weights(), played), played)[:, 2])
    assert np.median(wrong[played.step > 0]) < 0.3 < np.median(wrong[played.step == 0])


def test_the_same_episodes_give_the_same_belief_and_few_are_enough_to_have_one() -> None:
    played = play(ToyPeg(), guided_actor, 1, range(2))
    first, second = (fit_belief(weights(), played) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.isfinite(first).all()
