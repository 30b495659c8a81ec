"""Collects episodes into files by several processes: the same files however many processes there are.

A file holds a fixed number of episodes and is named by a hash of all that decides what is in it, so that a run goes on
where it was stopped, and episodes of another recipe, actor or version of the simulation are never taken for these.
"""

import hashlib
import inspect
import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.fem.model.settings import ContactModel
from vitac.envs.tasks.settings import Fidelity
from vitac.evaluator.version import evaluator_hash

from .episodes import TASK, Actor, ActorInput, Episodes, FloatArray, MakeActor, joined, make_environment, play
from .files import FileDamaged, digest, load, save
from .learning.critic import Critic, CriticPlan, stack_states
from .pool import map_in_order
from .streams import Use, stream
from .submission.policy import CANDIDATES, candidate_actions, felt_motion, values


class ActorKind(StrEnum):
    """Kinds of actors."""

    RANDOM = "random"
    """Random motions of a size that each episode has of its own."""
    GUIDED = "guided"
    """Knows the offset and moves towards the hole, with noise."""
    CRITIC = "critic"
    """Knows the truth and takes the critic's best action, with noise."""
    STUDENT = "student"
    """Takes the student's best action, with noise."""

    @property
    def knows_truth(self) -> bool:
        """Whether its actions depend on what no policy sees, so that its histories must not teach a student."""
        return self in (ActorKind.GUIDED, ActorKind.CRITIC)


MOTION = np.array([2.0, 2.0, 4.0])
"""Motion of an action of 1 [mm, mm, deg]."""
_GRID = candidate_actions(CANDIDATES)


def random_actor(random: np.random.Generator) -> Actor:
    """Return an actor whose motions are all small or all large."""
    size = random.uniform(0.2, 1.0)
    return lambda _: np.asarray(size * random.uniform(-1, 1, 3), dtype=np.float32)


def guided_actor(random: np.random.Generator) -> Actor:
    """Return an actor that goes to the hole, more or less straight."""
    spread = random.uniform(0.0, 0.6)

    def act(moment: ActorInput) -> FloatArray:
        x, y, theta = moment.truth[:3].tolist()
        sine, cosine = np.sin(np.radians(theta)), np.cos(np.radians(theta))
        way = np.array([-cosine * x - sine * y, sine * x - cosine * y, -theta]) / MOTION
        return _noisy(way, spread, random)

    return act


def critic_actor(critic: Critic, noise: float) -> MakeActor:
    """Return what makes actors that take the critic's best action with some noise."""

    def make(random: np.random.Generator) -> Actor:
        spread = noise * random.uniform()

        def act(moment: ActorInput) -> FloatArray:
            state = stack_states(moment.truth[None], np.array([moment.shape]), np.array([moment.step]))
            return _noisy(_GRID[int(critic.log_odds(state, _GRID)[0].argmax())], spread, random)

        return act

    return make


def student_actor(weights: dict[str, Any], noise: float) -> MakeActor:
    """Return what makes actors that take a student's best action with some noise."""

    def make(random: np.random.Generator) -> Actor:
        spread = noise * random.uniform()

        def act(moment: ActorInput) -> FloatArray:
            best = int(np.argmax(values(weights, moment.history.features(), _GRID)))
            return _noisy(_GRID[best], spread, random)

        return act

    return make


def _noisy(action: NDArray[Any], spread: float, random: np.random.Generator) -> FloatArray:
    return np.asarray(np.clip(action + spread * random.standard_normal(3), -1, 1), dtype=np.float32)


FILE_EPISODES = 50


@dataclass(frozen=True, kw_only=True)
class CollectedBatch:
    """Episodes of one actor that are collected together.

    Attributes:
        kind: of the actor.
        seed: of the training run.
        use: what the episodes are for.
        first: number of the first episode; batches that must differ have numbers of their own.
        count: how many.
        noise: largest spread of the noise on the actions of student and critic.
        fidelity: of the simulation.
        contact_model: of the environment.
        draws: quantities that differ from episode to episode, with their lowest and highest values.
    """

    kind: ActorKind
    seed: int
    use: Use
    first: int
    count: int
    noise: float = 0.0
    fidelity: Fidelity = Fidelity.FULL
    contact_model: ContactModel = ContactModel.CHALLENGE_2025
    draws: tuple[tuple[str, float, float], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Networks:
    """What actors act by, where they do.

    Attributes:
        plan: of the critic.
        critic: its state.
        student: weights of the student.
    """

    plan: CriticPlan
    critic: Mapping[str, Any]
    student: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Work:
    """One file to be made."""

    batch: CollectedBatch
    networks: Networks | None
    first: int
    count: int
    path: Path


def _tell_nobody(done: int, files: int) -> None:
    """Stand in for a listener where there is none."""


def collect(
    batch: CollectedBatch,
    folder: Path,
    *,
    networks: Networks | None = None,
    processes: int = 1,
    ray: str | None = None,
    report_file: Callable[[int, int], None] = _tell_nobody,
) -> Episodes:
    """Return the episodes of a batch: those that are in files already, and the others after making their files.

    Args:
        batch: which episodes.
        folder: of the files.
        networks: what the actors act by.
        processes: how many play.
        ray: address of a Ray cluster that plays instead.
        report_file: called with the number of files and the total.

    Raises:
        NotSaved: a file cannot be written.
        StreamRefused: an official list has such episodes.
    """
    works = list(_works(batch, folder, networks))
    missing = [work for work in works if not _is_whole(work.path)]
    report_file(len(works) - len(missing), len(works))
    made = map_in_order(_play, missing, processes, ray=ray)
    for done, (work, arrays) in enumerate(zip(missing, made, strict=True), start=len(works) - len(missing) + 1):
        save(work.path, arrays)
        report_file(done, len(works))
    return joined([Episodes(**load(work.path)) for work in works])


def _works(batch: CollectedBatch, folder: Path, networks: Networks | None) -> Iterator[_Work]:
    acted_by = {} if networks is None else {"critic": networks.critic, "student": networks.student}
    known = {name: digest(arrays) for name, arrays in acted_by.items() if name == batch.kind}
    for first in range(batch.first, batch.first + batch.count, FILE_EPISODES):
        count = min(FILE_EPISODES, batch.first + batch.count - first)
        decides = {**asdict(batch), **known, "first": first, "count": count, **_versions()}
        name = hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()
        yield _Work(batch=batch, networks=networks, first=first, count=count, path=folder / f"{name}.npz")


@cache
def _versions() -> dict[str, str]:
    """Return what else decides what is in a file: the task, the simulation, and how markers become what was felt."""
    felt_by = hashlib.sha256(inspect.getsource(felt_motion).encode()).hexdigest()
    return {"task": TASK, "made_by": evaluator_hash(), "felt_by": felt_by}


def _is_whole(path: Path) -> bool:
    """Return whether a file is there as it was written; a damaged one is made again."""
    if not path.exists():
        return False
    try:
        load(path)
    except FileDamaged:
        return False
    return True


def _play(work: _Work) -> dict[str, NDArray[Any]]:
    """Play the episodes of a file, and return what goes into it."""
    batch = work.batch
    env = _environment(batch)
    played = play(env, _actor(work), stream(batch.seed, batch.use), range(work.first, work.first + work.count))
    return played.arrays()


def _actor(work: _Work) -> MakeActor:
    kind, noise, networks = work.batch.kind, work.batch.noise, work.networks
    if kind is ActorKind.RANDOM:
        return random_actor
    if kind is ActorKind.GUIDED:
        return guided_actor
    assert networks is not None  # noqa: S101 - the caller gives them for these kinds
    if kind is ActorKind.STUDENT:
        return student_actor(dict(networks.student), noise)
    critic = Critic.from_state(networks.plan, networks.critic)
    return critic_actor(critic, noise)


_ENVIRONMENTS: dict[tuple[Any, ...], Any] = {}
"""Environments of each process."""


def _environment(batch: CollectedBatch) -> Any:
    key = os.getpid(), batch.fidelity, batch.contact_model, batch.draws
    if key not in _ENVIRONMENTS:
        _ENVIRONMENTS[key] = make_environment(
            fidelity=batch.fidelity.value,
            contact_model=batch.contact_model.value,
            draws={name: (low, high) for name, low, high in batch.draws} or None,
        )
    return _ENVIRONMENTS[key]
