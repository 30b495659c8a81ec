"""What is read of a ManiSkill environment: all of its state, and its observation as plain arrays."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final
from weakref import ref

import numpy as np
from numpy.typing import NDArray

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
