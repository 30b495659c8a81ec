"""How exactly a task is simulated: as it is ranked, or faster for training, with a measured bias; light to import."""

from dataclasses import replace
from enum import StrEnum
from typing import Any, TypeVar

from .settings import SettingsError

SettingsT = TypeVar("SettingsT")

FIDELITY = "fidelity"
_STEP_TOLERANCE_M, _RESIDUAL_TOLERANCE_N = 1e-5, 1e-2


class Fidelity(StrEnum):
    """Named trades of exactness for speed."""

    FULL = "full"
    """As episodes are ranked."""
    TRAINING = "training"
    """The challenge's gel in fewer elements, solved to a hundredth of a newton; never ranked (docs/training.md)."""


def find_fidelity(name: str, *, has_own_gel: bool) -> Fidelity:
    """Return the fidelity that an argument names.

    Args:
        name: as given.
        has_own_gel: whether the environment was given a gel, a sensor or a folder of meshes.

    Raises:
        SettingsError: it names none, or one that has a gel of its own beside a given one.
    """
    if name not in set(Fidelity):
        raise SettingsError(f"Argument 'fidelity' is {name!r}, expected one of {', '.join(Fidelity)}.")
    if has_own_gel and name != Fidelity.FULL:
        raise SettingsError(
            f"Argument 'fidelity' is '{name}', which has a gel of its own; leave out gel, sensor and assets_dir."
        )
    return Fidelity(name)


def with_fidelity(settings: SettingsT, fidelity: Fidelity) -> SettingsT:
    """Return the settings of a task with the solver of a fidelity.

    Raises:
        SettingsError: the settings were given a solver that is not the default one.
    """
    if fidelity is Fidelity.FULL:
        return settings
    from ..fem.model.settings import SolverSettings

    physics: Any = settings.physics  # type: ignore[attr-defined]
    if physics.solver != SolverSettings():
        raise SettingsError(f"Argument 'fidelity' is '{fidelity}', which has a solver of its own; leave out yours.")
    solver = SolverSettings(step_tolerance_m=_STEP_TOLERANCE_M, residual_tolerance_n=_RESIDUAL_TOLERANCE_N)
    return replace(settings, physics=replace(physics, solver=solver))  # type: ignore[type-var]
