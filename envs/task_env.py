"""What every tactile task environment shares: episodes, randomness, clocks, hashes and how an episode ends.

A task adds its scene, its books of commanded motion, its goal and its variation.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .errors import VitacError
from .fem import SOLVER_VERSION
from .grasped_scene import Clocks, GraspedScene
from .settings import nearest
from .stopwatch import Stopwatch
from .tactile.markers import MARKER_COUNT

FloatArray = NDArray[np.float64]
Observation = dict[str, NDArray[np.float32]]
Info = dict[str, Any]

RNG_SEED = "rng_seed"
# Mean motion of a sensing surface that raises `tactile_movement_too_large`.
LARGEST_SURFACE_DIFF_M = 1.5e-3


class EndReason(StrEnum):
    """Why an episode ended; where several hold, the first of them in this order is given."""

    NOT_CONVERGED = "not_converged"  # the physics found no solution; nothing moves any more
    SUCCESS = "success"  # the goal is reached
    TACTILE = "tactile"  # a sensing surface moved too far
    ERROR = "error"  # the gripper or the part left its range
    STEPS = "steps"  # the env steps are used up


class ResetOptionsError(VitacError):
    """An option of `reset` is unknown or out of range; the message names it and what it may be."""


class ActionError(VitacError):
    """An action has the wrong shape or is not a finite number; the message says what was expected."""


class NotReset(VitacError):
    """An environment was used before its first `reset`; call `reset` first."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How an env step is judged.

    Attributes:
        success: the goal is reached.
        failure: the flag that ends the episode, or None.
        reward: of this env step.
        info: the task's own entries of `info`, in the order of the challenge's logs.
    """

    success: bool
    failure: EndReason | None
    reward: float
    info: Info


class TactileTaskEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Base of the tactile tasks.

    `step` goes on after an end, so that recorded actions can be played past it. Counters and clocks are sums over all
    episodes.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]
    # For error messages: the registered id, and what each number of an action means.
    env_id: ClassVar[str]
    action_names: ClassVar[tuple[str, ...]]
    # Options of `reset` beside `rng_seed`.
    option_names: ClassVar[tuple[str, ...]]

    solver_version = SOLVER_VERSION

    def __init__(self) -> None:
        self._clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
        self._scene: GraspedScene | None = None
        self._earlier_ipc_steps = 0
        self._episode_random: np.random.Generator | None = None
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.action_names),), np.float32)

    @property
    def ipc_steps(self) -> int:
        """IPC steps solved so far."""
        return self._earlier_ipc_steps + (0 if self._scene is None else self._scene.ipc_steps)

    @property
    def physics_cpu_s(self) -> float:
        """CPU time of building and stepping scenes so far [s]."""
        return self._clocks.physics.elapsed_s

    @property
    def marker_cpu_s(self) -> float:
        """CPU time of marker flows so far [s]."""
        return self._clocks.markers.elapsed_s

    @property
    def scene(self) -> GraspedScene:
        """The scene of the running episode."""
        if self._scene is None:
            raise NotReset(f"{self.env_id} has no scene yet; call reset first.")
        return self._scene

    def state_hash(self) -> str:
        """SHA-256 [hex] of the physical state after the last reset or env step."""
        return self.scene.state_hash()

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start an episode; see the class for the options.

        Raises:
            ResetOptionsError: an option is unknown or out of range.
        """
        super().reset(seed=seed)
        chosen = dict(options or {})
        self._refuse_unknown(chosen)
        self._episode_random = self._generator(chosen.pop(RNG_SEED, None))
        self._earlier_ipc_steps = self.ipc_steps
        self._scene = self._start(chosen, self._episode_random)
        info = self._reset_info()
        end_reason = None if self._scene.solved else EndReason.NOT_CONVERGED
        return self._observation(), self._completed(info, end_reason)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Play one env step.

        Raises:
            ActionError: the action has another shape than the action space or is not finite.
        """
        command = self._checked(action)
        self._move(command)
        verdict = self._judge()
        end_reason = self._end_reason(verdict)
        succeeded = end_reason is EndReason.SUCCESS
        truncated = not self.scene.solved or verdict.failure is not None
        info = self._completed(verdict.info, end_reason)
        return self._observation(), verdict.reward, succeeded, truncated, info

    @abstractmethod
    def mesh_hash(self) -> str:
        """SHA-256 [hex] of the meshes, materials and settings in use."""

    @abstractmethod
    def _start(self, options: dict[str, Any], random: np.random.Generator) -> GraspedScene:
        """Build the scene of a new episode, grasp, and capture the references."""

    @abstractmethod
    def _reset_info(self) -> Info:
        """The task's own entries of `info` after a reset."""

    @abstractmethod
    def _move(self, command: FloatArray) -> None:
        """Enter an action, values as given, in the books and drive the gripper there."""

    @abstractmethod
    def _judge(self) -> Verdict:
        """Judge the env step that was just played."""

    @abstractmethod
    def _task_observation(self) -> Observation:
        """Observation entries other than the marker flow, in the order of the observation space."""

    def _observation(self) -> Observation:
        assert self._episode_random is not None  # noqa: S101 - set by reset
        flow = self.scene.marker_flow(self._episode_random)
        return self._task_observation() | {"marker_flow": flow}

    def _completed(self, info: Info, end_reason: EndReason | None) -> Info:
        return info | {
            "end_reason": None if end_reason is None else str(end_reason),
            "step_reports": self.scene.take_reports(),
        }

    def _end_reason(self, verdict: Verdict) -> EndReason | None:
        if not self.scene.solved:
            return EndReason.NOT_CONVERGED
        return EndReason.SUCCESS if verdict.success else verdict.failure

    def _refuse_unknown(self, options: dict[str, Any]) -> None:
        known = [*self.option_names, RNG_SEED]
        for name in options:
            if name not in known:
                raise ResetOptionsError(f"{self.env_id} has no reset option '{name}'; {nearest(name, known)}")

    def _generator(self, rng_seed: Any) -> np.random.Generator:
        """Generator of the episode: from the seed sequence in the options, else the environment's own."""
        if rng_seed is None:
            return self.np_random
        parts = list(rng_seed) if isinstance(rng_seed, (tuple, list)) else [rng_seed]
        if not parts or not all(isinstance(part, int) and part >= 0 for part in parts):
            raise ResetOptionsError(
                f"{self.env_id}: option '{RNG_SEED}' is {rng_seed!r}, expected non-negative integers "
                "(list seed, episode number)."
            )
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(parts)))

    def _checked(self, action: NDArray[np.float32]) -> FloatArray:
        try:
            command = np.asarray(action, dtype=np.float32).astype(np.float64)
        except (TypeError, ValueError) as error:
            raise ActionError(f"Action for {self.env_id} is {action!r}, expected numbers: {error}.") from error
        expected = (len(self.action_names),)
        if command.shape != expected:
            names = ", ".join(self.action_names)
            raise ActionError(f"Action has shape {command.shape}, expected {expected} [{names}] for {self.env_id}.")
        if not np.isfinite(command).all():
            raise ActionError(f"Action {command.tolist()} for {self.env_id} is not finite; expected -1 to 1.")
        return command


def full_range(*shape: int) -> gymnasium.spaces.Box:
    """Space of all finite float32 arrays of a shape."""
    largest = np.finfo(np.float32).max
    return gymnasium.spaces.Box(-largest, largest, shape, np.float32)


def observation_space(own: Mapping[str, gymnasium.spaces.Box]) -> "gymnasium.Space[Observation]":
    """A task's own entries and `marker_flow`: [sensor left, right][reference, current][marker][u, v] in pixels."""
    flow = full_range(2, 2, MARKER_COUNT, 2)
    return cast("gymnasium.Space[Observation]", gymnasium.spaces.Dict({**own, "marker_flow": flow}))
