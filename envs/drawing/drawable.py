"""How the task of an environment is drawn and what moves in it, as the task's own folder says."""

from pkgutil import resolve_name

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..scene.perspective import NextAction, Perspective
from ..tasks.registry import task_definitions


class NotDrawable(VitacError):
    """A task has no perspective, or nobody has said where it goes; the message says which tasks can be drawn."""


def find_perspective(env_id: str) -> Perspective:
    """Return how the task of an environment is drawn.

    Raises:
        NotDrawable: the task has no perspective.
    """
    chosen = {key: task.perspective for key, task in task_definitions().items() if task.perspective}
    if env_id not in chosen:
        known = ", ".join(sorted(chosen))
        raise NotDrawable(f"No view of {env_id} has been chosen, so it cannot be drawn; there are views of {known}.")
    perspective: Perspective = resolve_name(chosen[env_id])
    return perspective


def straight_to_target(env_id: str) -> NextAction:
    """Return what chooses actions from the info of an env step: straight to the target, as fast as the task allows.

    Raises:
        NotDrawable: nobody has said what the target of this environment is.
    """
    chosen = {key: task.guided_motion for key, task in task_definitions().items() if task.guided_motion}
    if env_id not in chosen:
        raise NotDrawable(f"No motion is known for {env_id}; give actions or a policy.")
    next_action: NextAction = resolve_name(chosen[env_id])
    return next_action


FloatArray = NDArray[np.float64]
