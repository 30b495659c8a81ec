"""Where the definition of a task's environment comes from: the tasks' own folders, or the track file itself."""

from collections.abc import Mapping
from typing import Any

from vitac.envs.errors import VitacError
from vitac.envs.maniskill.definition import find_definition, is_maniskill
from vitac.envs.tasks.definition import TaskDefinition
from vitac.envs.tasks.registry import task_definitions


class UnknownEnvironment(VitacError):
    """No environment has this id; the message lists those that there are."""


def environment_definition(env_id: str, settings: Mapping[str, Any]) -> TaskDefinition:
    """Return what is known of an environment, with settings that a track file gives.

    Raises:
        UnknownEnvironment: there is none of that id.
        VitacError: it cannot be a task with these settings.
    """
    if is_maniskill(env_id):
        return find_definition(env_id, settings)
    if env_id not in task_definitions():
        raise UnknownEnvironment(f"env_id is {env_id!r}, expected one of {', '.join(sorted(task_definitions()))}.")
    return task_definitions()[env_id]
