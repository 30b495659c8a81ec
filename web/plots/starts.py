"""Starts of episodes in words. Called by maps, plots and the page of an episode."""

from collections.abc import Sequence

from vitac.envs.scene.perspective import signed
from vitac.evaluator.tracks import Task


def describe_start(task: Task, offset: Sequence[float]) -> str:
    """Return the components of a start's offset with their names and units."""
    third = "turned {}°" if any(action.name == "theta" for action in task.definition.actions) else "z {} mm"
    labels = ("x {} mm", "y {} mm", third, "z {} mm")
    pairs = zip(labels, offset, strict=False)  # fusion adds its hole
    return ", ".join(label.format(signed(value)) for label, value in pairs)
