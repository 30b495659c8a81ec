"""What was seen in a demonstration, by playing it again, and the file that says where the episodes come from."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from vitac.envs.observable import Observable
from vitac.envs.tasks.definition import chosen_observables
from vitac.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeOutcome, StateHash
from vitac.evaluator.strict_model import StrictModel, Word
from vitac.evaluator.tracks import Task

from ..files import write_text
from .collecting import Demonstration, DemonstrationKind, Source

_MOST_NUMBERS = 2048
"""Size of an observable above which it is seen only when it is asked for."""


class DemonstrationDiffers(VitacError):
    """A demonstration led to other states than when it was collected; play it with the version that collected it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """An episode of n env steps as it was seen.

    Attributes:
        demonstration: that was played.
        observations: by key, each with n + 1 entries.
        actions: shape [n, action size].
        rewards: shape [n].
        last_info: of the last env step, or of the reset.
    """

    demonstration: Demonstration
    observations: dict[str, NDArray[Any]]
    actions: NDArray[np.float32]
    rewards: NDArray[np.float32]
    last_info: Mapping[str, Any]


def choose_observables(task: Task, keys: Collection[str] | None) -> tuple[Observable[Any], ...]:
    """Return the observables with these keys, by default coloured pictures and all that have few numbers.

    Optional ones of the task, such as the pictures of both gels, are observed where they are asked for.

    Raises:
        UnknownObservationKey: the task does not have one.
    """
    listed = task.definition.observables
    if keys is not None:
        return chosen_observables((*listed, *task.definition.optional_observables), keys)
    return tuple(entry for entry in listed if is_coloured_picture(entry) or prod(entry.shape) <= _MOST_NUMBERS)


def is_coloured_picture(entry: Observable[Any]) -> bool:
    """Return whether an observable is one picture in red, green and blue."""
    return entry.dtype == "uint8" and len(entry.shape) == 3 and entry.shape[-1] == 3


def make_observed_environment(task: Task, observables: Collection[Observable[Any]], **settings: Any) -> Any:
    """Return an environment of a task that observes these, privileged ones included, with settings beside its own."""
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environment ids

    keys = [entry.name for entry in observables]
    arguments: dict[str, Any] = {"observation_keys": keys, **task.environment_arguments, **settings}
    optional = {entry.name for entry in task.definition.optional_observables}.intersection(keys)
    if optional:
        arguments["optional_observables"] = (*task.optional_observables, *sorted(optional))
    return gymnasium.make(task.env_id, disable_env_checker=True, privileged=True, **arguments).unwrapped


def play_again(env: Any, source: Source, demonstration: Demonstration) -> Frames:
    """Play a demonstration again and return what was seen.

    Raises:
        DemonstrationDiffers: a state is another one.
    """
    observation, info = env.reset(options=demonstration.options(source))
    actions, seen, rewards = demonstration.actions.to_array(), [observation], []
    _compare(env, source, demonstration, 0)
    for env_step, action in enumerate(actions, start=1):
        observation, reward, *_, info = env.step(action)
        _compare(env, source, demonstration, env_step)
        seen.append(observation)
        rewards.append(reward)
    return Frames(
        demonstration=demonstration,
        observations={key: np.stack([each[key] for each in seen]) for key in observation},
        actions=actions,
        rewards=np.array(rewards, dtype=np.float32),
        last_info=info,
    )


def _compare(env: Any, source: Source, demonstration: Demonstration, env_step: int) -> None:
    if env.state_hash() != demonstration.state_hashes[env_step]:
        made = source.manifest
        raise DemonstrationDiffers(
            f"Episode {demonstration.episode} of {made.task} has another state after env step {env_step} than when it "
            f"was collected, with evaluator {made.evaluator_version} on {made.platform_class}. Play it there, or "
            "collect again."
        )


ORIGIN = Path("meta/vitac.json")
"""Its name in the folder of the data set."""


class NotOurs(VitacError):
    """A data set does not say where its episodes come from, so they cannot be played again."""


class StoredEpisode(StrictModel):
    """What the table of a data set does not say of a demonstration."""

    episode: int
    kind: DemonstrationKind
    shape: Word
    outcome: EpisodeOutcome
    total_reward: float
    final_state_hash: StateHash

    @classmethod
    def of(cls, demonstration: Demonstration) -> Self:
        """Return that of a demonstration."""
        return cls(
            episode=demonstration.episode,
            kind=demonstration.kind,
            shape=demonstration.shape,
            outcome=demonstration.outcome,
            total_reward=demonstration.total_reward,
            final_state_hash=demonstration.state_hashes[-1],
        )


class Origin(StrictModel):
    """Where the episodes of a data set come from."""

    source: Source
    episodes: tuple[StoredEpisode, ...]


def write_origin(folder: Path, origin: Origin) -> None:
    """Write the file of a data set.

    Raises:
        NotSaved: it cannot be written.
    """
    write_text(folder / ORIGIN, origin.model_dump_json(indent=1) + "\n")


def read_origin(folder: Path) -> Origin:
    """Read the file of a data set.

    Raises:
        NotOurs: there is none.
    """
    try:
        return Origin.model_validate_json((folder / ORIGIN).read_text())
    except (OSError, ValidationError) as error:
        raise NotOurs(
            f"{folder / ORIGIN} cannot be read, expected what `vitac data export` writes. Only such data sets say how "
            "their episodes started, which a replay needs."
        ) from error
