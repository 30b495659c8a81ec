"""The published hyperparameters, as challenge-facts 8 has them."""

import pytest
from vitac.evaluator.tracks import find_task
from vitac.training.reference.hyperparameters import HYPERPARAMETERS


@pytest.mark.parametrize(
    ("task", "env_steps", "policy_delay", "truths"),
    [("peg-insertion", 400_000, 5, ("gt_offset",)), ("lock-opening", 80_000, 2, ("key1", "key2"))],
)
def test_what_differs_by_task(task: str, env_steps: int, policy_delay: int, truths: tuple[str, ...]) -> None:
    found = HYPERPARAMETERS[task]
    assert (found.env_steps, found.policy_delay, found.truths) == (env_steps, policy_delay, truths)
    assert found.env_id == find_task(task)[1].env_id


@pytest.mark.parametrize("task", HYPERPARAMETERS)
def test_what_all_tasks_share(task: str) -> None:
    found = HYPERPARAMETERS[task]
    assert (found.buffer_size, found.learning_starts, found.batch_size) == (10_000, 1000, 128)
    assert (found.learning_rate, found.discount, found.tau) == (3e-4, 0.99, 0.005)
    assert (found.target_noise, found.target_noise_clip, found.action_noise) == (0.5, 1.0, 0.5)
    assert (found.env_steps_per_training, found.checkpoint_env_steps, found.log_interval, found.seed) == (
        2,
        2000,
        10,
        0,
    )
