"""Gymnasium environments and the tactile simulation under them; importing this package registers the `ViTac/*` ids."""

from importlib.metadata import version

import gymnasium

from .tasks.registry import task_definitions

ENVIRONMENTS = {env_id: task.environment for env_id, task in task_definitions().items()}
"""Place of the class of every environment; a string, so that registering does not import the simulation."""

for _id in ENVIRONMENTS:
    if _id not in gymnasium.registry:
        gymnasium.register(
            _id,
            entry_point="vitac.envs.tasks.making:make",
            vector_entry_point="vitac.envs.tasks.making:ForkedVectorEnv",
            kwargs={"env_id": _id},
        )


def __getattr__(name: str) -> str:
    """Return the version of the distribution as `__version__`, which only an installation has."""
    if name == "__version__":
        return version("vitac-arena")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
