"""What every tactile task environment shares: episodes, randomness, clocks, hashes and how an episode ends.

A task adds its scene, its books of commanded motion, its goal and its variation.
"""

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ..assets import Meshes, mesh_hash
from ..errors import VitacError
from ..fem import SOLVER_VERSION
from ..fem.model.mesh import SurfaceMesh
from ..scene.grasped_scene import Clocks, GraspedScene
from ..scene.stopwatch import Stopwatch
from ..tactile.markers import MARKER_COUNT
from .settings import nearest

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


class TaskScene(Protocol):
    """A task's parts between the gels, and the motions of the gripper that the task knows."""

    grasped: GraspedScene

    def grasp(self) -> None:
        """Close on the held part, take the references, and go to where the first env step starts."""


SceneT = TypeVar("SceneT", bound=TaskScene)
SettingsT = TypeVar("SettingsT")


class TactileTaskEnv(gymnasium.Env[Observation, NDArray[np.float32]], Generic[SceneT, SettingsT]):
    """Base of the tactile tasks.

    `step` goes on after an end, so that recorded actions can be played past it. Counters and clocks are sums over all
    episodes.

    Args:
        settings: what the task leaves open.
        privileged: add the privileged entries to the observation.
        assets_dir: folder with the challenge's own meshes, or None.

    Attributes:
        settings: as given.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]
    # For error messages: the registered id, and what each number of an action means.
    env_id: ClassVar[str]
    action_names: ClassVar[tuple[str, ...]]
    # Options of `reset` beside `rng_seed`.
    option_names: ClassVar[tuple[str, ...]]
    # Length of `relative_motion`, and shapes of the privileged entries by name, in the order of the observation.
    motion_size: ClassVar[int]
    privileged_shapes: ClassVar[Mapping[str, tuple[int, ...]]]

    solver_version = SOLVER_VERSION

    def __init__(self, *, settings: SettingsT, privileged: bool, assets_dir: str | Path | None) -> None:
        self.settings = settings
        self._privileged = privileged
        self._meshes = Meshes(assets_dir)
        self._clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
        self._scene: SceneT | None = None
        self._env_steps = 0
        self._error_before = 0.0
        self._earlier_ipc_steps = 0
        self._episode_random: np.random.Generator | None = None
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.action_names),), np.float32)
        shapes = {**(self.privileged_shapes if privileged else {}), "relative_motion": (self.motion_size,)}
        self.observation_space = _observation_space(shapes | {"marker_flow": (2, 2, MARKER_COUNT, 2)})

    @property
    def ipc_steps(self) -> int:
        """IPC steps solved so far."""
        return self._earlier_ipc_steps + (0 if self._scene is None else self._scene.grasped.ipc_steps)

    @property
    def physics_cpu_s(self) -> float:
        """CPU time of building and stepping scenes so far [s]."""
        return self._clocks.physics.elapsed_s

    @property
    def marker_cpu_s(self) -> float:
        """CPU time of marker flows so far [s]."""
        return self._clocks.markers.elapsed_s

    @property
    def task_scene(self) -> SceneT:
        """The task's scene of the running episode."""
        if self._scene is None:
            raise NotReset(f"{self.env_id} has no scene yet; call reset first.")
        return self._scene

    @property
    def scene(self) -> GraspedScene:
        """The scene of the running episode, as every task has it."""
        return self.task_scene.grasped

    def state_hash(self) -> str:
        """SHA-256 [hex] of the physical state after the last reset or env step."""
        return self.scene.state_hash()

    def mesh_hash(self) -> str:
        """SHA-256 [hex] of the meshes, materials and settings in use."""
        return mesh_hash(self._meshes.gel(), self._solids(), self.settings)

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
        self._scene, self._env_steps = self._start(chosen, self._episode_random), 0
        self._scene.grasp()
        self._error_before = self._error()
        end_reason = None if self.scene.solved else EndReason.NOT_CONVERGED
        return self._observation(), self._completed(self._reset_info(), end_reason)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Play one env step.

        Raises:
            ActionError: the action has another shape than the action space or is not finite.
        """
        command = self._checked(action)
        self._env_steps += 1
        self._move(command)
        error_now = self._error()
        verdict = self._judge(self._error_before - error_now)
        self._error_before = error_now
        end_reason = self._end_reason(verdict)
        succeeded = end_reason is EndReason.SUCCESS
        truncated = not self.scene.solved or verdict.failure is not None
        info = self._completed(verdict.info, end_reason)
        return self._observation(), verdict.reward, succeeded, truncated, info

    @abstractmethod
    def _solids(self) -> list[SurfaceMesh]:
        """All rigid parts that an episode may have, in a fixed order."""

    @abstractmethod
    def _start(self, options: dict[str, Any], random: np.random.Generator) -> SceneT:
        """Build the scene of a new episode, with the gripper still open."""

    @abstractmethod
    def _error(self) -> float:
        """How far the episode is from its goal, the error e of the reward."""

    @abstractmethod
    def _reset_info(self) -> Info:
        """Return the task's own entries of `info` after a reset."""

    @abstractmethod
    def _move(self, command: FloatArray) -> None:
        """Drive the gripper as an action says, values as given, and enter it in the books."""

    @abstractmethod
    def _judge(self, progress: float) -> Verdict:
        """Judge the env step that was just played, which has brought the error down by `progress`."""

    @abstractmethod
    def _relative_motion(self) -> FloatArray:
        """Motion of the gripper since the reset, shape [motion_size]."""

    @abstractmethod
    def _privileged_observation(self) -> Mapping[str, FloatArray]:
        """Return the truth that only training sees."""

    def _observation(self) -> Observation:
        assert self._episode_random is not None  # noqa: S101 - set by reset
        own = self._privileged_observation() if self._privileged else {}
        known = {**own, "relative_motion": self._relative_motion()}
        flow = self.scene.marker_flow(self._episode_random)
        return {key: value.astype(np.float32) for key, value in known.items()} | {"marker_flow": flow}

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
        """Return the generator of the episode: from the seed sequence in the options, else the environment's own."""
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


def _observation_space(shapes: Mapping[str, tuple[int, ...]]) -> "gymnasium.Space[Observation]":
    """All finite float32 arrays of these shapes."""
    largest = np.finfo(np.float32).max
    boxes = [(key, gymnasium.spaces.Box(-largest, largest, shape, np.float32)) for key, shape in shapes.items()]
    return cast("gymnasium.Space[Observation]", gymnasium.spaces.Dict(boxes))
