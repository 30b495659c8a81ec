"""Plays a ManiSkill environment as the evaluator needs it: plain arrays, a hash of the state, ends by name.

Imports ManiSkill, SAPIEN and torch when an environment is made; a worker's shard process does.
"""

import gc
import hashlib
import json
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from time import process_time
from typing import Any, Final
from weakref import ref

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..extras import install_command
from ..tasks.definition import EndReason, chosen_observables
from ..tasks.settings import RNG_SEED, read_task_settings, refuse_unknown, seeded_generator
from .definition import CPU, PREFIX, ManiSkillSettings, catalogue, find_definition, needs_driver
from .driver import has_cuda, has_driver, replace_materials

Observation = dict[str, NDArray[Any]]


_PACKAGES = ("mani-skill", "sapien", "torch")
# Of the option that a list of starts has beside the shape; ManiSkill draws everything from the seed.
_OPTIONS = ("shape", "variant")
_LARGEST_SEED = 2**31 - 1
_SAME_ON_EVERY_CPU = {"ATEN_CPU_CAPABILITY": "default", "MKL_CBWR": "COMPATIBLE", "OMP_NUM_THREADS": "1"}
"""Read by torch when it is loaded. Its kernels for newer CPUs round otherwise, which moves the arm's controllers."""
_OTHER_VERSION = (
    f"install mani-skill {catalogue().made_with['mani-skill']}, or write the catalogue again "
    "(vitac.envs.maniskill.describing)."
)


class ManiSkillMissing(VitacError):
    """ManiSkill, or a driver that its pictures need, is not installed; the message says what to install."""


class ManiSkillFailed(VitacError):
    """An environment of ManiSkill raised an error or is not what the catalogue says; never the policy's fault."""


class ManiSkillEnv:
    """One scene of ManiSkill, in this process; on the CPU unless the settings name a GPU.

    Args:
        env_id: as in the track file.
        max_steps: env steps after which an episode ends.
        observation_keys: what is returned of the observation; all by default.
        settings: fields of `ManiSkillSettings` that are not the defaults.
        draws: whether `picture` is wanted, which needs a Vulkan driver.
        scene: of a batch, which is played like an environment of ManiSkill's own; one is made, alone, by default.
        clock: gives the CPU time [s] of the simulation.

    Attributes:
        solver_version: versions of what moves a state.

    Raises:
        ManiSkillMissing: a package or a driver is missing.
        ManiSkillFailed: it is not the environment that the catalogue describes.
    """

    def __init__(
        self,
        env_id: str,
        *,
        max_steps: int,
        observation_keys: Sequence[str] | None = None,
        settings: Mapping[str, Any] | None = None,
        draws: bool = False,
        scene: Any = None,
        clock: Callable[[], float] = process_time,
    ) -> None:
        self._clock = clock
        self._settings = read_task_settings(ManiSkillSettings, dict(settings or {}))
        self._task = find_definition(env_id, settings or {})
        listed = self._task.observables
        self._observed = listed if observation_keys is None else chosen_observables(listed, observation_keys)
        self._name = env_id.removeprefix(PREFIX)
        self._max_steps = max_steps
        self._env_steps = 0
        self._state = np.empty(0, np.float32)
        self.physics_cpu_s = 0.0
        self.marker_cpu_s = 0.0
        self.ipc_steps = 0
        self._env: Any = scene or made(self._name, self._settings, draws=draws)
        self.solver_version = "+".join(f"{name}-{version(name).partition('+')[0]}" for name in _PACKAGES)
        size = int(self._env.single_action_space.shape[0])
        if size != len(self._task.actions):
            raise ManiSkillFailed(
                f"{env_id} takes {size} numbers as an action, expected {len(self._task.actions)}; {_OTHER_VERSION}"
            )

    def mesh_hash(self) -> str:
        """Return the SHA-256 [hex] over id and settings; bodies are those of the named versions."""
        named: dict[str, object] = {"environment": self._name, "control_mode": self._settings.control_mode}
        if self._settings.sim_backend != CPU:
            named["sim_backend"] = self._settings.sim_backend
        if self._settings.batch_size > 1:
            named["batch_size"] = self._settings.batch_size
        return hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()

    def state_hash(self) -> str:
        """Return the SHA-256 [hex] over ManiSkill's state of all bodies and joints, float32, and the env step."""
        digest = hashlib.sha256(f"{self._env_steps} ".encode())
        digest.update(self._state.tobytes())
        return digest.hexdigest()

    def picture_hash(self) -> str | None:
        """Return None: pictures come from a driver, whose bits change with the CPU."""
        return None

    def picture(self) -> NDArray[np.uint8]:
        """Return what the camera sees that the environment has for people, RGB, shape [h, w, 3].

        Raises:
            ManiSkillFailed: it was not made with `draws`, or the driver failed.
        """
        with self._working("picture"):
            return unbatched(self._env.render()).astype(np.uint8)

    def reset(self, *, options: Mapping[str, object]) -> tuple[Observation, dict[str, Any]]:
        """Start an episode with new bodies, so that nothing of an earlier one remains in the simulation.

        The seed follows from the option `rng_seed`, the integers (list seed, episode number).

        Raises:
            ResetOptionsError: an option is unknown.
        """
        seed = compute_seed(self._task.env_id, options)
        self._env_steps = 0
        with self._working("reset"):
            observation, info = self._env.reset(seed=seed, options={"reconfigure": True})
            self._state = self._state_now()
        return self._plain(observation), self._info(info, None)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Play one env step; actions outside [-1, 1] are clipped.

        A state that is no longer finite ends the episode: the same actions would lead there for anybody.

        Raises:
            ManiSkillFailed: it raised an error, or gave NaN or infinity for actions that are finite.
        """
        command = np.clip(np.asarray(action, dtype=np.float32), -1.0, 1.0)
        with self._working("step"):
            observation, reward, *_, info = self._env.step(command)
            self._state = self._state_now()
        self._env_steps += 1
        if not np.isfinite(self._state).all():
            ended = {"steps": self._env_steps, "end_reason": str(EndReason.NOT_CONVERGED)}
            return self._plain(observation), 0.0, False, True, ended
        reason = self._end_reason(info)
        succeeded = reason is EndReason.SUCCESS
        truncated = reason is not None and not succeeded
        shown = self._info(info, reason)
        self._require_finite({"reward": float(reward)} | shown)
        return self._plain(observation), float(reward), succeeded, truncated, shown

    def _require_finite(self, values: Mapping[str, Any]) -> None:
        """Refuse what a record cannot hold: the actions were finite, so this is no failure of the policy."""
        wrong = [name for name, value in values.items() if not _is_finite(value)]
        if wrong:
            raise ManiSkillFailed(
                f"{self._task.env_id} gave {values[wrong[0]]} as {wrong[0]} at env step {self._env_steps}, expected "
                "finite numbers."
            )

    def _state_now(self) -> NDArray[np.float32]:
        return unbatched(self._env.get_state()).astype("<f4")

    def _end_reason(self, info: Mapping[str, Any]) -> EndReason | None:
        key = self._settings.success_key
        if key not in info:
            raise ManiSkillFailed(f"{self._task.env_id} has no {key!r} in its info, expected the success_key there.")
        if bool(info[key]):
            return EndReason.SUCCESS
        if bool(info.get("fail", False)):
            return EndReason.ERROR
        return EndReason.STEPS if self._env_steps >= self._max_steps else None

    def _plain(self, observation: Any) -> Observation:
        state = self._settings.obs_mode == "state"
        leaves = {"state": unbatched(observation)} if state else flattened(observation)
        plain = {}
        for entry in self._observed:
            value = leaves.get(entry.name)
            if value is None or (value.shape, str(value.dtype)) != (entry.shape, entry.dtype):
                got = "nothing" if value is None else f"{value.dtype} {value.shape}"
                raise ManiSkillFailed(
                    f"{self._task.env_id}: expected {entry.name} as {entry.dtype} {entry.shape}, got {got}; "
                    f"{_OTHER_VERSION}"
                )
            plain[entry.name] = value
        return plain

    def _info(self, info: Mapping[str, Any], reason: EndReason | None) -> dict[str, Any]:
        """Return the numbers of ManiSkill's info, with the reason of the end."""
        numbers = {key: value.cpu().numpy()[0] for key, value in info.items() if hasattr(value, "cpu") and value.ndim}
        values = {key: value.item() if value.size == 1 else value for key, value in numbers.items()}
        return {"steps": self._env_steps, **values, "end_reason": None if reason is None else str(reason)}

    @contextmanager
    def _working(self, what: str) -> Iterator[None]:
        """Count the CPU time of ManiSkill's work, and name the environment in its errors."""
        started = self._clock()
        try:
            yield
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise ManiSkillFailed(
                f"{self._task.env_id} failed in {what} at env step {self._env_steps}: {reason}"
            ) from error
        finally:
            self.physics_cpu_s += self._clock() - started


def compute_seed(env_id: str, options: Mapping[str, object]) -> int:
    """Return the seed with which ManiSkill starts the episode of these options.

    Raises:
        ResetOptionsError: an option is unknown.
    """
    refuse_unknown(env_id, options, _OPTIONS)
    return int(seeded_generator(env_id, options.get(RNG_SEED, 0)).integers(0, _LARGEST_SEED))


def _is_finite(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return bool(np.isfinite(value).all())
    return not isinstance(value, float) or math.isfinite(value)


def missing_packages() -> tuple[str, ...]:
    """Return those of the packages that are not installed."""
    missing = []
    for package in _PACKAGES:
        try:
            version(package)
        except PackageNotFoundError:
            missing.append(package)
    return tuple(missing)


def made(name: str, settings: ManiSkillSettings, *, draws: bool = False, n_scenes: int = 1) -> Any:
    """Return an environment as ManiSkill makes it.

    Args:
        name: ManiSkill's own id.
        settings: of the task.
        draws: whether pictures for people are wanted.
        n_scenes: that one simulation moves, side by side; more than one on a GPU only.

    Raises:
        ManiSkillMissing: a package, a driver or a GPU is missing.
    """
    missing = missing_packages()
    if missing:
        raise ManiSkillMissing(
            f"Tasks of ManiSkill need {', '.join(missing)} (extra maniskill, 3 GB). Put `--maniskill` before the "
            f"command (./vitac --maniskill evaluate ...), or install it with: {install_command('maniskill')}"
        )
    os.environ.update(_SAME_ON_EVERY_CPU)
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")  # SAPIEN brings its own
    import gymnasium
    import torch

    torch.set_num_threads(1)
    import mani_skill.envs  # noqa: F401 - registers the ids

    on_cpu = settings.sim_backend == CPU
    if not on_cpu and not has_cuda():
        raise ManiSkillMissing(
            f"{PREFIX}{name} with sim_backend {settings.sim_backend} needs an NVIDIA GPU and a torch with CUDA, and "
            f"torch {torch.__version__} finds none. Run it where both are there."
        )
    has_renderer = has_driver()
    is_drawn = draws or needs_driver(name, settings)
    if is_drawn and not has_renderer:
        what = f"A picture of {PREFIX}{name}" if draws else f"{PREFIX}{name} with obs_mode {settings.obs_mode}"
        raise ManiSkillMissing(
            f"{what} is drawn by SAPIEN, which finds no Vulkan driver. "
            "Install NVIDIA's driver, or Mesa 24.3 or newer: `apt-get install mesa-vulkan-drivers` on Debian 13 and "
            "Ubuntu 24.04, `apt-get install -t bookworm-backports mesa-vulkan-drivers` on Debian 12."
        )
    if not has_renderer:
        replace_materials()
    _keep_what_is_loaded()
    env: Any = gymnasium.make(
        name,
        num_envs=n_scenes,
        obs_mode=settings.obs_mode,
        control_mode=settings.control_mode,
        sim_backend=settings.sim_backend,
        render_mode="rgb_array" if draws else None,
        render_backend="none" if not is_drawn else "cpu" if on_cpu else "gpu",
    ).unwrapped
    # Nothing is learned here; without gradients an env step takes a tenth less time, and the same bits.
    for method in ("reset", "step", "get_state"):
        setattr(env, method, torch.inference_mode()(getattr(env, method)))
    if on_cpu:
        env.get_state = StateReader(env)
    return env


@cache
def _keep_what_is_loaded() -> None:
    """Spare all that is loaded from the collection that ManiSkill does at every reset: 200 ms with it, 2 ms without.

    Done once, before the first environment: what is frozen is never freed, so a later freeze would keep every
    environment that another one has replaced.
    """
    gc.collect()
    gc.freeze()


_AT_REST: Final = np.zeros(6, np.float32)
"""Velocities of what no force moves."""


class StateReader:
    """Reads the state of one scene on the CPU, shape [1, n]: float32, the same bits as `get_state`.

    Args:
        env: as ManiSkill made it.
    """

    def __init__(self, env: Any) -> None:
        self._env = env
        self._own_state: Callable[[], Any] = env.get_state
        self._compared: ref[Any] | None = None
        """The scene of which ManiSkill's own state was the same; not kept alive, for a reset builds another."""

    def __call__(self) -> NDArray[np.float32]:
        """Return the state of this moment.

        Raises:
            ValueError: ManiSkill's own is another. It is asked once for each scene that is built.
        """
        state = np.concatenate([*self._parts()])[np.newaxis]
        scene = self._env.scene
        if self._compared is None or self._compared() is not scene:
            own = self._own_state().numpy()
            if state.tobytes() != own.astype("<f4").tobytes():
                raise ValueError(f"expected the state that get_state gives, {own.tolist()}, got {state.tolist()}")
            self._compared = ref(scene)
        return state

    def _parts(self) -> Iterator[NDArray[np.float32]]:
        """Yield poses and velocities of actors and of articulations with their joints, then targets of controllers."""
        bodies = self._env.scene.state_dict_registry
        for actor in bodies.actors.values():
            if actor.px_body_type != "static":
                yield from _read_actor(actor)
        for articulation in bodies.articulations.values():
            yield from _read_articulation(articulation)
        yield from _leaves(self._env.agent.get_controller_state())


def _read_actor(actor: Any) -> tuple[NDArray[np.float32], ...]:
    (entity,), (body,) = actor._objs, actor._bodies
    pose = entity.pose
    if actor.px_body_type != "dynamic":
        return pose.p, pose.q, _AT_REST
    return pose.p, pose.q, body.linear_velocity, body.angular_velocity


def _read_articulation(articulation: Any) -> tuple[NDArray[np.float32], ...]:
    (joints,), (root,) = articulation._objs, articulation.root._objs
    pose = root.entity_pose
    return pose.p, pose.q, root.linear_velocity, root.angular_velocity, joints.qpos, joints.qvel


def _leaves(state: dict[str, Any]) -> Iterator[NDArray[np.float32]]:
    """Yield the tensors of a nested state in their order, without the batch dimension."""
    for value in state.values():
        if isinstance(value, dict):
            yield from _leaves(value)
        else:
            yield value.numpy()[0]


def flattened(observation: Mapping[str, Any], prefix: str = "") -> dict[str, NDArray[Any]]:
    """Return the leaves of a nested observation by their path, joined by `_`, in their order.

    `sensor_data` and `sensor_param` are left out of the path: the camera's name follows.
    """
    leaves: dict[str, NDArray[Any]] = {}
    for key, value in observation.items():
        path = prefix if key in {"sensor_data", "sensor_param"} else f"{prefix}{key}_"
        if isinstance(value, Mapping):
            leaves |= flattened(value, path)
        else:
            leaves[path.removesuffix("_")] = unbatched(value)
    return leaves


def unbatched(value: Any) -> NDArray[Any]:
    """Return a tensor or array of one environment without its batch dimension, in memory of its own."""
    array = np.array(value.cpu().numpy() if hasattr(value, "cpu") else value)
    first = array[0] if array.ndim else array
    return np.ascontiguousarray(first.astype(np.uint8) if first.dtype == np.bool_ else first)


def parts_of_state(observation: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Return names and sizes of the parts of the `state` vector, from the same observation as a dictionary."""
    return [(name, int(value.size)) for name, value in flattened(observation).items()]
