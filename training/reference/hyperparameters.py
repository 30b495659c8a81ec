"""The published hyperparameters of the challenge's own training (challenge-facts 8)."""

from dataclasses import dataclass

HIDDEN = 256
"""Units of both hidden layers of the critics."""


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """How a task is trained; the defaults are common to all tasks.

    Attributes:
        env_id: registered id of the environment.
        env_steps: of the whole training.
        truths: privileged observations that the critics see.
        policy_delay: trainings of the critics for one of the actor.
        buffer_size: of the replay buffer.
        learning_starts: env steps before the first training.
        env_steps_per_training: between two trainings, with as many gradient steps as env steps.
        batch_size: transitions of a gradient step.
        learning_rate: of Adam.
        target_noise: standard deviation of the noise on the next action.
        target_noise_clip: its largest size.
        action_noise: standard deviation of the noise on the action that is played.
        discount: of an env step.
        tau: part of the networks that goes into the target networks at each step.
        seed: of the training.
        checkpoint_env_steps: between two checkpoints, each with an evaluation.
        evaluation_episodes: that an evaluation plays, from starts that are not learned from.
        log_interval: episodes between two lines of the log.
    """

    env_id: str
    env_steps: int
    truths: tuple[str, ...]
    policy_delay: int
    buffer_size: int = 10_000
    learning_starts: int = 1000
    env_steps_per_training: int = 2
    batch_size: int = 128
    learning_rate: float = 3e-4
    target_noise: float = 0.5
    target_noise_clip: float = 1.0
    action_noise: float = 0.5
    discount: float = 0.99
    tau: float = 0.005
    seed: int = 0
    checkpoint_env_steps: int = 2000
    evaluation_episodes: int = 50
    log_interval: int = 10


HYPERPARAMETERS = {
    "peg-insertion": Hyperparameters(
        env_id="ViTac/PegInsertion-v1", env_steps=400_000, truths=("gt_offset",), policy_delay=5
    ),
    "lock-opening": Hyperparameters(
        env_id="ViTac/LockOpening-v1", env_steps=80_000, truths=("key1", "key2"), policy_delay=2
    ),
}
