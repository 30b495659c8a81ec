"""Who acts while episodes are collected: how large, how noisy, and by whose knowledge."""

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.training.collection import MOTION, ActorKind, critic_actor, guided_actor, random_actor, student_actor
from vitac.training.episodes import ActorInput, play
from vitac.training.learning.critic import Critic, CriticPlan, stack_states
from vitac.training.learning.network import Layout, new_parameters
from vitac.training.submission.policy import CANDIDATES, FELT_SIZE, HISTORY_SIZE, History, candidate_actions, values


def moment(offset: tuple[float, float, float] = (1.0, -2.0, 3.0), *, shape: int = 1, step: int = 0) -> ActorInput:
    history = History()
    history.observed(np.zeros(FELT_SIZE, dtype=np.float32), np.zeros(4, dtype=np.float32))
    truth = np.array([*offset, offset[0], offset[1], 19.875, 0, 0, offset[2]], dtype=np.float32)
    return ActorInput(history=history, truth=truth, shape=shape, step=step)


class Quiet:
    """Draws the least spread, and no noise that is not nothing."""

    def __init__(self, uniform: float = 0.0) -> None:
        self._uniform = uniform
        self.normal = np.random.default_rng(0)

    def uniform(self, *_: float) -> float:
        return self._uniform

    def standard_normal(self, count: int) -> np.ndarray:
        return self.normal.standard_normal(count)


def test_random_actor_has_one_size_for_an_episode() -> None:
    largest = []
    for seed in range(30):
        act = random_actor(np.random.default_rng(seed))
        actions = np.array([act(moment()) for _ in range(60)])
        assert actions.dtype == np.float32
        assert actions.shape == (60, 3)
        largest.append(np.abs(actions).max())
    assert min(largest) < 0.35
    assert max(largest) > 0.9
    assert max(largest) <= 1.0


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        ((1.0, 0.0, 0.0), (-0.5, 0.0, 0.0)),
        ((0.0, 1.0, 0.0), (0.0, -0.5, 0.0)),
        ((0.0, 0.0, 2.0), (0.0, 0.0, -0.5)),
        ((1.0, 0.0, 90.0), (0.0, 0.5, -1.0)),
        ((0.0, 1.0, -90.0), (0.5, 0.0, 1.0)),
        ((30.0, -30.0, 0.0), (-1.0, 1.0, 0.0)),
    ],
)
def test_guided_actor_goes_to_the_hole_along_its_own_axes(
    offset: tuple[float, float, float], expected: tuple[float, float, float]
) -> None:
    act = guided_actor(Quiet())  # type: ignore[arg-type]
    assert act(moment(offset)).tolist() == pytest.approx(expected, abs=1e-6)


def test_guided_actor_without_noise_reaches_the_hole_of_every_start_that_its_steps_reach() -> None:
    played = play(ToyPeg(), lambda _: guided_actor(Quiet()), 7, range(40))  # type: ignore[arg-type]
    assert played.solved.mean() > 0.95


def test_noise_of_a_guided_actor_is_drawn_for_each_episode() -> None:
    spreads = []
    for seed in range(30):
        act = guided_actor(np.random.default_rng(seed))
        actions = np.array([act(moment((0.0, 0.0, 0.0))) for _ in range(50)])
        assert np.abs(actions).max() <= 1.0
        spreads.append(float(actions.std()))
    assert min(spreads) < 0.1
    assert max(spreads) > 0.4


@pytest.fixture
def critic() -> Critic:
    return Critic(CriticPlan(networks=1, hidden=8), np.random.default_rng(4))


def test_critic_actor_without_noise_takes_the_best_of_the_candidates(critic: Critic) -> None:
    grid = candidate_actions(CANDIDATES)
    act = critic_actor(critic, 0.0)(np.random.default_rng(0))
    for step, shape in ((0, 0), (3, 2)):
        at = moment((2.0, 1.0, -4.0), shape=shape, step=step)
        state = stack_states(at.truth[None], np.array([shape]), np.array([step]))
        best = grid[int(critic.log_odds(state, grid)[0].argmax())]
        np.testing.assert_array_equal(act(at), best)


def test_noise_of_a_critic_actor_is_at_most_what_is_asked_for(critic: Critic) -> None:
    clean = critic_actor(critic, 0.0)(np.random.default_rng(0))(moment())
    full = critic_actor(critic, 0.5)(Quiet(uniform=1.0))  # type: ignore[arg-type]
    drawn = np.random.default_rng(0)
    for _ in range(20):
        np.testing.assert_allclose(full(moment()), np.clip(clean + 0.5 * drawn.standard_normal(3), -1, 1), rtol=1e-6)
    none = critic_actor(critic, 0.5)(Quiet())  # type: ignore[arg-type]
    np.testing.assert_array_equal(none(moment()), clean)


def test_student_actor_looks_at_the_history_only() -> None:
    layout = Layout(inputs=HISTORY_SIZE, actions=3, hidden=8)
    weights = {f"0_{name}": value for name, value in new_parameters(layout, np.random.default_rng(3)).items()}
    act = student_actor(weights, 0.0)(np.random.default_rng(0))
    at, elsewhere = moment((1.0, 1.0, 1.0), shape=0), moment((-4.0, 3.0, 9.0), shape=2, step=0)
    np.testing.assert_array_equal(act(at), act(elsewhere))
    grid = candidate_actions(CANDIDATES)
    np.testing.assert_array_equal(act(at), grid[int(np.argmax(values(weights, at.history.features(), grid)))])
    other = moment()
    other.history.acted(act(at))
    other.history.observed(np.full(FELT_SIZE, 0.5, dtype=np.float32), np.ones(4, dtype=np.float32))
    assert other.history.features().shape == (HISTORY_SIZE,)
    assert not np.array_equal(other.history.features(), at.history.features())


def test_only_guided_and_critic_know_the_truth() -> None:
    assert {kind for kind in ActorKind if kind.knows_truth} == {ActorKind.GUIDED, ActorKind.CRITIC}


def test_motion_of_a_whole_action_is_that_of_the_task() -> None:
    from vitac.training.submission.policy import ACTION_MM

    assert MOTION.tolist() == [ACTION_MM, ACTION_MM, 4.0]
