"""Families of environments that this machine can run; told to the service, and whose queues the worker takes from."""

from vitac.envs.maniskill.env import missing_packages
from vitac.envs.tasks.definition import Family


def families_here() -> tuple[Family, ...]:
    """Return the families whose packages are installed."""
    return (Family.TACTILE,) if missing_packages() else (Family.TACTILE, Family.MANISKILL)
