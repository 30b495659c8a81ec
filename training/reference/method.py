"""Trains as the challenge did and makes a submission of it; says what to install where torch is missing."""

import shutil
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from vitac.envs.errors import VitacError
from vitac.envs.extras import install_command

from ..files import write_text
from .hyperparameters import HYPERPARAMETERS, Hyperparameters

_NEEDED = ("torch", "stable_baselines3")


class TrainingPackagesMissing(VitacError):
    """The challenge's method needs packages that are not installed; the message says how to install them."""


class UnknownReferenceTask(VitacError):
    """The challenge's method is not known for this task; choose one that the message names."""


def require_packages() -> None:
    """Make sure that torch and Stable-Baselines3 are installed, without importing them.

    Raises:
        TrainingPackagesMissing: one is not.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise TrainingPackagesMissing(
            f"The challenge's method needs {' and '.join(missing)}, expected to be installed. "
            "Run it as ./vitac --torch train reference, which adds them with torch's build for CPUs; or install them "
            f"by: {install_command('training')}"
        )


def hyperparameters(task: str, seed: int = 0) -> Hyperparameters:
    """Return the published hyperparameters of a task.

    Raises:
        UnknownReferenceTask: there are none.
    """
    if task not in HYPERPARAMETERS:
        raise UnknownReferenceTask(f"The task is '{task}', expected one of {', '.join(HYPERPARAMETERS)}.")
    return replace(HYPERPARAMETERS[task], seed=seed)


def train_reference(task: str, folder: Path, *, env_steps: int | None = None, seed: int = 0) -> Path:
    """Train as the challenge did, and return a submission; its checkpoints and log lie in the folder too.

    Args:
        task: name of the task.
        folder: a folder for the training; `submission/` in it becomes the submission.
        env_steps: in place of the published number.
        seed: of the training.

    Raises:
        TrainingPackagesMissing: torch or Stable-Baselines3 is not installed.
        UnknownReferenceTask: the task is unknown.
    """
    chosen = hyperparameters(task, seed)
    require_packages()
    from .td3 import train

    formats = ["csv", *(["tensorboard"] if find_spec("tensorboard") else [])]
    make = partial(_environment, chosen)
    model = train(task, chosen, make, folder, env_steps or chosen.env_steps, formats)
    return _submission(task, model, folder / "submission")


def _environment(chosen: Hyperparameters) -> Any:
    """Return the environment, with random starts; those of an episode list come only by its own seeds."""
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environments

    keys = ("marker_flow", "relative_motion", *chosen.truths)
    return gymnasium.make(chosen.env_id, disable_env_checker=True, privileged=True, observation_keys=keys)


def _submission(task: str, model: Path, folder: Path) -> Path:
    track = folder / "Track_1"
    write_text(
        track / "submission.yaml",
        f"track: track_1\ntasks: [{task}]\nname: challenge's TD3\nentry_point: policy:Policy\n"
        "observation_keys: [marker_flow, relative_motion]\n",
    )
    shutil.copyfile(Path(__file__).with_name("policy.py"), track / "policy.py")
    shutil.copyfile(model, track / f"{task}.zip")
    return folder
