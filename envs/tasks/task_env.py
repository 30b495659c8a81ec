"""What every tactile task environment shares: episodes, randomness, clocks, hashes and how an episode ends.

A task adds its definition, its scene, its goal and its variation. `EpisodeSnapshot` holds a running episode's state.
"""

import hashlib
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, ClassVar, Generic, NoReturn, Protocol, TypeVar, cast

import gymnasium
import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..assets import Meshes
from ..fem import SOLVER_VERSION
from ..fem.model.mesh import GelMesh, SurfaceMesh
from ..fem.model.settings import ContactModel
from ..observable import Observable
from ..scene.grasped_scene import Clocks, GraspedScene, GraspState, Stopwatch
from ..signals import signals_wait
from ..tactile.design import SensorDesign
from ..vision.still import StillCamera
from .definition import EndReason, Flags, TaskDefinition, append_tables, chosen_observables
from .quantities import (
    Randomization,
    Ranges,
    check_draws,
    draw_quantities,
    drawn_settings,
    find_randomization,
    with_quantities,
)
from .settings import (
    RNG_SEED,
    Fidelity,
    chosen_shapes,
    find_fidelity,
    read_task_settings,
    refuse_unknown,
    require,
    seeded_generator,
    with_contact_model,
    with_fidelity,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Generators:
    """The random numbers that are to come.

    Attributes:
        own: generator of the environment.
        episode: generator of the episode; None where it is the environment's own.
    """

    own: np.random.Generator
    episode: np.random.Generator | None

    def copied(self) -> "Generators":
        """Return generators that give the same numbers without changing what these give."""
        return deepcopy(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeSnapshot:
    """What `restore` needs; it belongs to the environment that made it and to no other process.

    Attributes:
        owner: the environment that made it.
        scene: of the episode; it is shared by all snapshots of the episode and built again by none.
        commanded: what was commanded so far and what else the task's scene keeps, beside the physics.
        grasp: state of the physics, the gripper and the sensors.
        error: how far the episode was from its goal.
        drawn: quantities of the episode.
        generators: as they were.
    """

    owner: Any
    scene: Any
    commanded: dict[str, Any]
    grasp: GraspState
    error: float
    drawn: dict[str, float]
    generators: Generators

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied, as the scene would come along.

        Raises:
            TypeError: always.
        """
        raise TypeError(
            "A snapshot cannot leave the process and the environment that made it. Send the seed and the actions "
            "instead, and play them again: the states are the same to the last bit."
        )


FloatArray = NDArray[np.float64]
Observation = dict[str, NDArray[Any]]
Info = dict[str, Any]


class ActionError(VitacError):
    """An action has the wrong type or shape or is not finite; the message says what was expected."""


class ForeignSnapshot(VitacError):
    """A snapshot belongs to another environment; restore it there, or replay the actions from a `reset` here."""


class NotReset(VitacError):
    """An environment was used before its first `reset`; call `reset` first."""


class NotRenderable(VitacError):
    """Pictures were asked for of a task that does not say how it is looked at; give it a `perspective`."""


class TaskScene(Protocol):
    """A task's parts between the gels, what was commanded so far, and the motions of the gripper that the task knows.

    Attributes:
        grasped: the physics, the gripper and its sensors.
        env_steps: played so far in the episode.
    """

    grasped: GraspedScene
    env_steps: int

    def grasp(self) -> None:
        """Close on the held part, take the references, and go to where the first env step starts."""

    def move(self, command: FloatArray) -> None:
        """Update the commanded pose as an action says, values as given, and drive the gripper there."""


SceneT = TypeVar("SceneT", bound=TaskScene)
SettingsT = TypeVar("SettingsT")


class TactileTaskEnv(gymnasium.Env[Observation, NDArray[np.float32]], Generic[SceneT, SettingsT]):
    """Base of the tactile tasks.

    `step` also runs after an end, so that recorded actions can be played past it. Counters and clocks are sums over all
    episodes.

    Args:
        privileged: add the privileged entries to the observation, for training.
        assets_dir: folder with the challenge's own meshes, to be used in place of the generated ones.
        gel: elastomer of both sensors; the challenge's by default.
        sensor: a design of both sensors with gel, camera and markers of its own; the challenge's by default.
        observables: what is to be observed besides, such as a camera's pictures.
        optional_observables: keys of those of `TaskDefinition.optional_observables` that are observed, too.
        observation_keys: which of the task's own observables are observed, privileged ones included where these are
            added; all of them by default. Others are not computed.
        shapes: which shapes are drawn where `reset` names none; all by default. Autoreset keeps them.
        randomization: "challenge" draws what has a published training range for every episode, from the episode's
            generator and after its start; "none" draws nothing.
        draws: ranges of the task's quantities (`TaskDefinition.quantities`), from which every episode has values of its
            own; they are in the info as `draws`, and in no observation.
        contact_model: "challenge-2025" or "arena-2", with its own constants; by default that of the task's settings.
        fidelity: "full", as episodes are ranked, or "training": faster, on coarser gels, never ranked.
        force_limit_n: largest force on the held part [N] that an env step may reach; beyond it the episode has failed.
            None for no limit.
        render_mode: "rgb_array" for pictures by `render`.
        **overrides: fields of the task's settings.

    Attributes:
        settings: what the task leaves open.
        fidelity: how exactly it is simulated.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 4}  # type: ignore[misc]
    task: ClassVar[TaskDefinition]
    settings_type: ClassVar[type[Any]]
    scene_type: ClassVar[type[Any]]
    # Closed set of the shapes that `reset` can draw; a task without shapes has none.
    shape_type: ClassVar[type[StrEnum] | None] = None
    # Published training ranges of settings.
    training_ranges: ClassVar[Ranges] = {}
    # Options of `reset` beside `rng_seed`.
    option_names: ClassVar[tuple[str, ...]]

    solver_version = SOLVER_VERSION

    def __init_subclass__(cls, **keywords: Any) -> None:
        """Say how the task is drawn, and add the tables of its actions and observations to the docstring.

        A base of several tasks has no task of its own.
        """
        super().__init_subclass__(**keywords)
        if not hasattr(cls, "task"):
            return
        if cls.task.perspective is None:
            cls.metadata = cls.metadata | {"render_modes": []}
        if cls.__doc__:
            cls.__doc__ = append_tables(cls.__doc__, cls.task)

    def __init__(
        self,
        *,
        privileged: bool = False,
        assets_dir: str | Path | None = None,
        gel: GelMesh | None = None,
        sensor: SensorDesign | None = None,
        observables: Sequence[Observable[Any]] = (),
        optional_observables: Sequence[str] = (),
        observation_keys: Sequence[str] | None = None,
        shapes: Sequence[str] | None = None,
        randomization: str = Randomization.NONE.value,
        draws: Mapping[str, Sequence[float]] | None = None,
        contact_model: str | None = None,
        fidelity: str = Fidelity.FULL.value,
        force_limit_n: float | None = None,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        has_own_gel = not (assets_dir is None and gel is None and sensor is None)
        self.fidelity = find_fidelity(fidelity, has_own_gel=has_own_gel)
        given = read_task_settings(self.settings_type, overrides)
        given = with_contact_model(given, contact_model, has_own_gel=has_own_gel)
        self.settings: SettingsT = with_fidelity(given, self.fidelity)
        observed = self.task.with_optional(optional_observables)
        own = observed.observables if privileged else observed.public_observables
        plotted_keys = tuple(entry.name for entry in own if entry.curves)
        if observation_keys is not None:
            own = chosen_observables(own, observation_keys)
        self._meshes = Meshes(
            assets_dir,
            gel=gel,
            sensor=sensor,
            is_coarse=self.fidelity is Fidelity.TRAINING,
            is_arena=self.settings.physics.contact.model is ContactModel.ARENA_2,
        )
        self._observed_keys, self._plotted_keys = tuple(entry.name for entry in own), plotted_keys
        self._further_observables = tuple(observables)
        self._observables = self._list_observables(self._observed_keys)
        self._shapes: tuple[Any, ...] = chosen_shapes(self.env_id, self.shape_type, shapes)
        self._randomization = find_randomization(randomization)
        self._draws = check_draws(self.env_id, draws or {}, self.task.quantities)
        self._drawn: dict[str, float] = {}
        usable = force_limit_n is None or 0 < force_limit_n < inf
        require(usable, "force_limit_n", force_limit_n, "None or a positive force in N")
        self._force_limit_n = force_limit_n
        modes = self.metadata["render_modes"]
        if render_mode is not None and not modes:
            raise NotRenderable(f"{self.env_id} has no perspective, so there are no pictures of it.")
        require(render_mode in (None, *modes), "render_mode", render_mode, "None or rgb_array")
        self.render_mode = render_mode
        self._still: StillCamera | None = None
        self._clocks = Clocks(physics=Stopwatch(), markers=Stopwatch())
        self._scene: SceneT | None = None
        self._error_before = 0.0
        self._earlier_ipc_steps = 0
        self._episode_random: np.random.Generator | None = None
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.task.actions),), np.float32)
        self.observation_space = _observation_space(self._observables)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle needs; the task's observables are read by functions without a name."""
        return {name: value for name, value in vars(self).items() if name != "_observables"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over a state; the episode in it goes on here with the same bits as there."""
        vars(self).update(state)
        self._observables = self._list_observables(self._observed_keys)

    def _list_observables(self, keys: Iterable[str]) -> tuple[Observable[SceneT], ...]:
        """Return the task's own observables of these keys, and those that were added."""
        own = {entry.name: entry for entry in (*self.task.observables, *self.task.optional_observables)}
        nodes = self._meshes.sensing_node_count()
        chosen = (*(own[key] for key in keys), *self._further_observables)
        return tuple(entry.with_nodes(nodes) for entry in chosen)

    @property
    def plotted_observables(self) -> tuple[Observable[SceneT], ...]:
        """Those with curves, whose values are in every info; `observation_keys` leaves none of them out."""
        return tuple(entry for entry in self._list_observables(self._plotted_keys) if entry.curves)

    @property
    def env_id(self) -> str:
        """Registered id of the environment."""
        return self.task.env_id

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
        """Return the SHA-256 [hex] of the physical state after the last reset or env step."""
        return self.scene.state_hash()

    def mesh_hash(self) -> str:
        """Return the SHA-256 [hex] of the meshes, materials and settings in use."""
        return self._meshes.hash(self._solids(), (self.settings, self._draws) if self._draws else self.settings)

    def picture_hash(self) -> str | None:
        """Return the SHA-256 [hex] of all pictures of the task after the last reset or env step, observed or not.

        None where the task has no cameras.
        """
        pictures = [entry for entry in self.task.observables if entry.picture]
        if not pictures:
            return None
        digest = hashlib.sha256()
        for entry in pictures:
            values = self._value(entry).astype(np.dtype(entry.dtype).newbyteorder("<"))
            digest.update(f"{entry.name} {entry.dtype} {values.shape}\n".encode())
            digest.update(values.tobytes())
        return digest.hexdigest()

    @signals_wait()
    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start an episode; see the class for the options.

        Raises:
            ResetOptionsError: an option is unknown or out of range.
        """
        super().reset(seed=seed)
        chosen = dict(options or {})
        refuse_unknown(self.env_id, chosen, self.option_names)
        rng_seed = chosen.pop(RNG_SEED, None)
        random = self.np_random if rng_seed is None else seeded_generator(self.env_id, rng_seed)
        self._episode_random = random
        self._earlier_ipc_steps = self.ipc_steps
        self._drawn = draw_quantities(self._draws, random)
        self._scene = self._start(chosen, random)
        self._still = None
        self._scene.grasp()
        self._error_before = self._error()
        end_reason = None if self.scene.solved else EndReason.NOT_CONVERGED
        return self._observation(), self._completed(Flags(), end_reason)

    @signals_wait()
    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Play one env step; Ctrl-C ends it where it is over.

        Raises:
            ActionError: the action is not an array of real numbers, has another shape than the action space, or is not
                finite.
        """
        command = self._checked(action)
        self.task_scene.env_steps += 1
        self.scene.begin_env_step()
        self.task_scene.move(command)
        error_now = self._error()
        flags = self._limited(self._judge())
        reward = self._reward(flags, self._error_before - error_now)
        self._error_before = error_now
        end_reason = self._end_reason(flags)
        terminated, truncated = self._ending(flags, end_reason)
        info = self._completed(replace(flags, is_success=end_reason is EndReason.SUCCESS), end_reason)
        return self._observation(), reward, terminated, truncated, info

    def snapshot(self) -> EpisodeSnapshot:
        """Return the state of the running episode, so that `restore` can continue from here, to the same bits.

        Raises:
            NotReset: no episode was started.
        """
        scene, own, episode = self.task_scene, self.np_random, self._episode_random
        return EpisodeSnapshot(
            owner=self,
            scene=scene,
            commanded={**vars(scene)},
            grasp=scene.grasped.state(),
            error=self._error_before,
            drawn=self._drawn,
            generators=Generators(own=own, episode=None if episode is own else episode).copied(),
        )

    def restore(self, snapshot: EpisodeSnapshot) -> None:
        """Continue the episode of a snapshot that this environment made, as often as you like.

        Counters and clocks are sums of all that was played and do not go back.

        Raises:
            ForeignSnapshot: another environment made it; both would play in the same scene.
        """
        if snapshot.owner is not self:
            raise ForeignSnapshot(
                f"The snapshot was made by another environment of {snapshot.owner.env_id}. Expected one of this "
                f"environment of {self.env_id}: reset it and play the actions again."
            )
        self._earlier_ipc_steps = self.ipc_steps - snapshot.grasp.ipc_steps
        if snapshot.scene is not self._scene:
            self._still = None
        self._scene = snapshot.scene
        vars(snapshot.scene).update(snapshot.commanded)
        snapshot.scene.grasped.restore(snapshot.grasp)
        self._error_before, self._drawn = snapshot.error, snapshot.drawn
        generators = snapshot.generators.copied()
        self.np_random = generators.own
        self._episode_random = generators.own if generators.episode is None else generators.episode

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the scene, red, green and blue, shape [480, 640, 3]; None without a `render_mode`.

        The perspective is that of `vitac show`; the camera does not move within an episode.

        Raises:
            NotReset: no episode was started.
        """
        if self.render_mode is None:
            return None
        if self._still is None:
            assert self.task.perspective is not None  # noqa: S101 - there is no render_mode without
            self._still = StillCamera(self.scene, resolve_name(self.task.perspective))
        return self._still.picture()

    def _settings_of_episode(self, random: np.random.Generator) -> SettingsT:
        """Return the settings of an episode, those with a training range drawn where this was asked for."""
        settings = self._settings_with_draws()
        if self._randomization is Randomization.NONE:
            return settings
        return drawn_settings(settings, self.training_ranges, random)

    def _settings_with_draws(self) -> SettingsT:
        """Return the settings with what was drawn for the episode out of `draws`."""
        return with_quantities(self.settings, self.task.quantities, self._drawn)

    @abstractmethod
    def _solids(self) -> list[SurfaceMesh]:
        """Return all rigid parts that an episode may have, in a fixed order."""

    @abstractmethod
    def choose_start(self, options: Mapping[str, Any], random: np.random.Generator, settings: SettingsT) -> Any:
        """Return the start that the options of `reset` give; what they leave open is drawn.

        Args:
            options: of the task; none is unknown.
            random: the episode's generator.
            settings: of the episode, before the randomization draws any.

        Raises:
            ResetOptionsError: an option is not usable.
        """

    def _start(self, options: Mapping[str, Any], random: np.random.Generator) -> SceneT:
        """Build the scene of a new episode, with the gripper still open."""
        start = self.choose_start(options, random, self._settings_with_draws())
        settings = self._settings_of_episode(random)
        scene: SceneT = self.scene_type(start=start, meshes=self._meshes, settings=settings, clocks=self._clocks)
        return scene

    @abstractmethod
    def _error(self) -> float:
        """Return how far the episode is from its goal, the error e of the reward."""

    @abstractmethod
    def _judge(self) -> Flags:
        """Return the flags of the env step that was just played."""

    @abstractmethod
    def _reward(self, flags: Flags, progress: float) -> float:
        """Return the reward of the env step that was just played, which has brought the error down by `progress`."""

    @abstractmethod
    def _info(self, flags: Flags) -> Info:
        """Return the task's own entries of `info`, in the order of the challenge's logs."""

    def _common_info(self, flags: Flags) -> Info:
        """Return the entries of `info` that most tasks begin with."""
        return {
            "steps": self.task_scene.env_steps,
            "surface_diff_m": self.scene.surface_diff_m(),
            "tactile_movement_too_large": flags.tactile_movement_too_large,
            "too_many_steps": flags.too_many_steps,
            "error_too_large": flags.error_too_large,
        }

    def _observation(self) -> Observation:
        return {entry.name: self._value(entry) for entry in self._observables}

    def _value(self, entry: Observable[Any]) -> NDArray[Any]:
        scene = self.task_scene
        assert self._episode_random is not None  # noqa: S101 - set by reset, as the scene is
        return np.asarray(entry.read(scene, self._episode_random)).astype(entry.dtype)

    def _ending(self, flags: Flags, end_reason: EndReason | None) -> tuple[bool, bool]:
        """Return whether an env step has terminated the episode, and whether it has truncated it."""
        return end_reason is EndReason.SUCCESS, not self.scene.solved or flags.failure is not None

    def _limited(self, flags: Flags) -> Flags:
        """Return the flags of an env step with that of the force limit, where there is one: beyond it is no success."""
        if self._force_limit_n is None or self.scene.peak_part_force_n() <= self._force_limit_n:
            return flags
        return replace(flags, force_too_large=True, is_success=False)

    def _completed(self, flags: Flags, end_reason: EndReason | None) -> Info:
        limit_n, is_beyond = self._force_limit_n, flags.force_too_large
        limited = {} if limit_n is None else {"force_limit_n": limit_n, "force_too_large": is_beyond}
        drawn = {"draws": dict(self._drawn)} if self._draws else {}
        return {
            **self._info(flags),
            **limited,
            **drawn,
            **{entry.name: self._value(entry) for entry in self.plotted_observables},
            "end_reason": None if end_reason is None else str(end_reason),
            "step_reports": self.scene.take_reports(),
        }

    def _end_reason(self, flags: Flags) -> EndReason | None:
        if not self.scene.solved:
            return EndReason.NOT_CONVERGED
        return EndReason.SUCCESS if flags.is_success else flags.failure

    def _checked(self, action: NDArray[np.float32]) -> FloatArray:
        try:
            given = np.asanyarray(action)
        except (TypeError, ValueError) as error:
            raise ActionError(f"Action for {self.env_id} is {action!r}, expected numbers: {error}.") from error
        is_masked = hasattr(given, "mask")  # asking for numpy.ma would load it, which takes 50 ms
        if is_masked or given.dtype.kind not in "fiu":
            kind = "a masked array" if is_masked else "an array"
            raise ActionError(
                f"Action for {self.env_id} is {kind} of type {given.dtype}, expected an array of real numbers."
            )
        command = np.asarray(given, dtype=np.float32).astype(np.float64)
        expected = (len(self.task.actions),)
        if command.shape != expected:
            names = ", ".join(f"{component.name} {component.unit}" for component in self.task.actions)
            raise ActionError(f"Action has shape {command.shape}, expected {expected} [{names}] for {self.env_id}.")
        if not np.isfinite(command).all():
            raise ActionError(f"Action {command.tolist()} for {self.env_id} is not finite; expected -1 to 1.")
        return command


def _observation_space(observables: Iterable[Observable[Any]]) -> "gymnasium.Space[Observation]":
    """Return all finite arrays of the shapes and types of these observables."""
    boxes = [(entry.name, _box(entry.shape, np.dtype(entry.dtype))) for entry in observables]
    return cast("gymnasium.Space[Observation]", gymnasium.spaces.Dict(boxes))


def _box(shape: tuple[int, ...], dtype: np.dtype[Any]) -> gymnasium.spaces.Box:
    limits = np.finfo(dtype) if dtype.kind == "f" else np.iinfo(dtype)
    return gymnasium.spaces.Box(limits.min, limits.max, shape, dtype.type)
