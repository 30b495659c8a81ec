"""All tasks by the id of their environment: those in the folders beside this module, and those of other packages.

Another package adds a task by an entry point of the group `vitac.tasks` that names a `TaskDefinition`.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules

from vitac.errors import VitacError

from .definition import TaskDefinition

ENTRY_POINT_GROUP = "vitac.tasks"


class TaskRejected(VitacError):
    """A package adds a task that cannot be used; the message names the package. Correct it or uninstall it."""


@cache
def task_definitions() -> Mapping[str, TaskDefinition]:
    """Return the definition of every task by the id of its environment.

    Raises:
        TaskRejected: another package adds what is no task, or one that is there already.
    """
    known = {task.env_id: task for task in _own_tasks()}
    for point in added_tasks():
        task = _loaded(point)
        if task.env_id in known:
            raise TaskRejected(f"{_origin(point)} adds {task.env_id}, which is there already; choose another id.")
        known[task.env_id] = task
    return known


def added_tasks() -> tuple[EntryPoint, ...]:
    """Return the entry points by which other packages add tasks, sorted by name."""
    return tuple(sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: (point.name, point.value)))


def find_package(env_id: str) -> str | None:
    """Return the package that adds the task of an environment; None for our own, and for what no package adds."""
    own = {task.env_id for task in _own_tasks()}
    if env_id in own:
        return None
    return next((point.module.partition(".")[0] for point in added_tasks() if _loaded(point).env_id == env_id), None)


def _own_tasks() -> Iterator[TaskDefinition]:
    """Yield the task, or the tasks, of each folder beside this module that has a definition."""
    for folder in iter_modules([str(Path(__file__).parent)]):
        place = f"{__package__}.{folder.name}.definition"
        if folder.ispkg and find_spec(place):
            definition = import_module(place)
            yield from definition.TASKS if hasattr(definition, "TASKS") else (definition.TASK,)


def _loaded(point: EntryPoint) -> TaskDefinition:
    try:
        task = point.load()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
        raise TaskRejected(
            f"{_origin(point)} adds the task {point.value}, which cannot be loaded ({reason})."
        ) from error
    if not isinstance(task, TaskDefinition):
        kind = type(task).__name__
        raise TaskRejected(f"{_origin(point)} adds {point.value}, expected a TaskDefinition, got {kind}.")
    return task


def _origin(point: EntryPoint) -> str:
    return f"The package {point.dist.name}" if point.dist else f"The entry point {point.name}"
