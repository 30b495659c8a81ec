"""Reward of the tasks that insert a peg, as the 2025 code has it (challenge-facts 6.1, 6.3)."""

from ..ending import Flags
from .settings import InsertionSettings


def insertion_reward(flags: Flags, settings: InsertionSettings, *, progress: float, env_steps: int) -> float:
    """Return the reward of an env step: progress, less the penalty, plus what the end brings [D13].

    The force, tactile or error flag costs 2 P for every step that is left, less one P, which the published formula does
    not have [D10]; running out of steps costs nothing more.

    Args:
        flags: of the env step.
        settings: of the task.
        progress: by how much the env step has brought the error e down.
        env_steps: played so far, this one included.
    """
    final = 0.0
    if flags.force_too_large or flags.tactile_movement_too_large or flags.error_too_large:
        final = -2.0 * settings.step_penalty * (settings.max_steps - env_steps) + settings.step_penalty
    elif flags.is_success:
        final = settings.final_reward
    return progress - settings.step_penalty + final
