"""Trains as the challenge did and makes a submission of it; says what to install where torch is missing."""

import shutil
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from vitac.envs.errors import VitacError
from vitac.envs.extras import install_command

from ..files import write_text
from ..run import Tell, claimed
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


def train_reference(
    task: str, folder: Path, *, env_steps: int | None = None, seed: int = 0, tell: Tell = lambda _: None
) -> Path:
    """Train as the challenge did, or go on, and return a submission; its checkpoints and log lie in the folder too.

    Args:
        task: name of the task.
        folder: a folder for the training; `submission/` in it becomes the submission.
        env_steps: in place of the published number.
        seed: of the training.
        tell: is told how far the training is, a line each.

    Raises:
        TrainingPackagesMissing: torch or Stable-Baselines3 is not installed.
        UnknownReferenceTask: the task is unknown.
        OtherRun: the folder is that of another training or version, or holds more env steps, or another process trains
            there.
        StreamRefused: an official list has the seed of a stream of this training.
        NotSaved: the disk is full.
        FileDamaged: what to go on from is not what was written.
        TrainingDiverged: a loss is no number; all to go on from is kept.
    """
    chosen = hyperparameters(task, seed)
    require_packages()
    versions = {name: version(name) for name in _NEEDED}
    with claimed(folder, {"task": task, **asdict(chosen), **versions}, tell):
        from .td3 import train

        model = train(task, chosen, partial(_environment, chosen), folder, env_steps or chosen.env_steps, tell)
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
