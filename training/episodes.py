"""Plays episodes to learn from, and holds what was observed, done and true in them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .submission.policy import History, felt_motion

FloatArray = NDArray[np.float32]
IndexArray = NDArray[np.int64]

ENV_ID = "ViTac/PegInsertion-v1"
TASK = "peg-insertion"
TRUTHS = ("gt_offset", "measured_pose")
"""Privileged keys whose numbers make up a row of `truth`: 3 and 6."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Episodes:
    """Episodes one after the other; an episode of n env steps has n + 1 observations.

    Attributes:
        lengths: env steps of each episode, shape [e].
        shapes: number of the shape of each, shape [e].
        solved: whether each ended with success, shape [e].
        felt: `felt_motion` of the observations [mm, deg], shape [o, 6].
        motions: `relative_motion` of the observations [mm, mm, deg, mm], shape [o, 4].
        truths: offset and measured pose [mm, deg], shape [o, 9].
        actions: shape [a, 3].
    """

    lengths: IndexArray
    shapes: IndexArray
    solved: NDArray[np.bool_]
    felt: FloatArray
    motions: FloatArray
    truths: FloatArray
    actions: FloatArray

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def observations(self) -> IndexArray:
        """Index of the observation before each action, shape [a]; the one after it is the next."""
        episode = np.repeat(np.arange(len(self.lengths)), self.lengths)
        return np.arange(len(self.actions)) + episode

    @property
    def step(self) -> IndexArray:
        """Env steps played before each action, shape [a]."""
        starts = np.cumsum(self.lengths) - self.lengths
        return np.arange(len(self.actions)) - np.repeat(starts, self.lengths)

    @property
    def last(self) -> NDArray[np.bool_]:
        """Whether each action is the last of its episode, shape [a]."""
        ends = np.zeros(len(self.actions), dtype=np.bool_)
        ends[np.cumsum(self.lengths) - 1] = True
        return ends

    @property
    def reached(self) -> NDArray[np.bool_]:
        """Whether each action led to success, shape [a]."""
        ends = np.zeros(len(self.actions), dtype=np.bool_)
        ends[np.cumsum(self.lengths) - 1] = self.solved
        return ends

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def joined(parts: Sequence[Episodes]) -> Episodes:
    """Return episodes one after the other; there must be some."""
    arrays = [part.arrays() for part in parts]
    return Episodes(**{name: np.concatenate([each[name] for each in arrays]) for name in arrays[0]})


@dataclass(frozen=True, kw_only=True, eq=False)
class ActorInput:
    """What an actor may look at before an env step.

    Attributes:
        history: what a policy knows.
        truth: offset and measured pose, shape [9].
        shape: number of the shape.
        step: env steps played so far.
    """

    history: History
    truth: FloatArray
    shape: int
    step: int


Actor = Callable[[ActorInput], FloatArray]
MakeActor = Callable[[np.random.Generator], Actor]


def play(env: Any, make_actor: MakeActor, seed: int, numbers: Iterable[int]) -> Episodes:
    """Play episodes of a stream, each with an actor of its own that has a generator of its own.

    Args:
        env: of `make_environment`.
        make_actor: gives the actor of an episode.
        seed: of the stream.
        numbers: of the episodes.
    """
    return joined([_play_one(env, make_actor, seed, number) for number in numbers])


def make_environment(**arguments: Any) -> Any:
    """Return an environment that gives what is stored of an episode."""
    import gymnasium
    import vitac.envs  # noqa: F401 - registers the environment

    keys = ("marker_flow", "relative_motion", "shape", *TRUTHS)
    made = gymnasium.make(ENV_ID, disable_env_checker=True, privileged=True, observation_keys=keys, **arguments)
    return made.unwrapped


def _play_one(env: Any, make_actor: MakeActor, seed: int, number: int) -> Episodes:
    actor = make_actor(np.random.default_rng((seed, number, 1)))
    observation, info = env.reset(options={"rng_seed": (seed, number)})
    history = History()
    truths: list[FloatArray] = []
    actions: list[FloatArray] = []
    shape, ended = int(observation["shape"][0]), False
    while True:
        history.observed(felt_motion(observation["marker_flow"]), observation["relative_motion"])
        truths.append(np.concatenate([observation[key] for key in TRUTHS]))
        if ended:
            break
        action = actor(ActorInput(history=history, truth=truths[-1], shape=shape, step=len(actions)))
        observation, _, terminated, truncated, info = env.step(action)
        history.acted(action)
        actions.append(action)
        ended = terminated or truncated
    return Episodes(
        lengths=np.array([len(actions)]),
        shapes=np.array([shape]),
        solved=np.array([bool(info["is_success"])]),
        felt=np.array(history.felt, dtype=np.float32),
        motions=np.array(history.motions, dtype=np.float32),
        truths=np.array(truths, dtype=np.float32),
        actions=np.array(actions, dtype=np.float32),
    )
