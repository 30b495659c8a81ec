"""The student: histories, their mirror images, and what it learns of the critic."""

import numpy as np
import pytest
from toy_peg import ToyPeg
from vitac.training.actors import ActorKind, guided_actor, random_actor, student_actor
from vitac.training.critic import Critic, CriticPlan
from vitac.training.episodes import joined, play
from vitac.training.student import Student, StudentPlan, histories_of, mirrored_history
from vitac.training.submission.policy import HISTORY_SIZE, History, motion_field


def flow_in_the_mirror(marker_flow: np.ndarray) -> np.ndarray:
    """What the sensors see of the same events in a mirror with normal x: v turns round the picture's middle."""
    seen = marker_flow.copy()
    seen[..., 1] = 250.0 - seen[..., 1]
    return seen


def test_mirrored_history_is_that_of_the_mirrored_episode() -> None:
    random = np.random.default_rng(0)
    history, mirror = History(), History()
    for _ in range(3):
        flow = random.uniform(20, 220, (2, 2, 128, 2)).astype(np.float32)
        motion = random.standard_normal(4)
        history.add(motion_field(flow), motion)
        mirror.add(motion_field(flow_in_the_mirror(flow)), motion * [-1, 1, -1, 1])
    found = mirrored_history(history.features()[None])[0]
    np.testing.assert_allclose(found, mirror.features(), atol=1e-4)
    np.testing.assert_array_equal(mirrored_history(found[None])[0], history.features())


def test_histories_are_those_that_a_policy_has() -> None:
    histories: list[np.ndarray] = []

    def watched(random: np.random.Generator) -> object:
        actor = random_actor(random)

        def act(moment: object) -> np.ndarray:
            histories.append(moment.history.features())  # type: ignore[attr-defined]
            return actor(moment)  # type: ignore[arg-type]

        return act

    played = play(ToyPeg(), watched, 3, range(6))  # type: ignore[arg-type]
    found = histories_of(played)
    np.testing.assert_array_equal(found.felt, np.array(histories))
    assert found.felt.shape == (len(played.actions), HISTORY_SIZE)
    assert len(found.states) == len(found.felt)


def test_learns_from_what_is_felt_what_the_critic_sees() -> None:
    random = np.random.default_rng(0)
    blind = play(ToyPeg(), random_actor, 7, range(150))
    critic = Critic(CriticPlan(networks=2, hidden=32, sweeps=8, epochs=4, batch=64), random)
    critic.learn(joined([blind, play(ToyPeg(), guided_actor, 7, range(150))]), random, lambda _, __: None)
    student = Student(StudentPlan(networks=1, hidden=48, epochs=12, batch=32, rate=5e-3), random)
    losses: list[float] = []
    student.learn(histories_of(blind), critic, random, lambda _, loss: losses.append(loss))
    assert losses[-1] < losses[0]
    solved = play(ToyPeg(), student_actor(student.weights(), 0.0), 8, range(40)).solved.mean()
    assert solved > 0.6 > 2 * play(ToyPeg(), random_actor, 8, range(40)).solved.mean()


@pytest.mark.parametrize("kind", ActorKind)
def test_actors_that_know_the_truth_are_marked(kind: ActorKind) -> None:
    assert kind.knows_truth == (kind.value in ("guided", "critic"))
