"""An episode recorded for drawing: positions after every env step, or after every IPC step. Made by `record`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..fem.contact.forces import PairForces
from ..fem.model.mesh import GelMesh, SurfaceMesh
from ..observable import Observable
from ..scene.grasped_scene import GraspedScene, PhysicsSettings
from ..scene.gripper import SensorPose
from ..tactile.camera import CameraIntrinsics
from ..tasks.task_env import Info, Observation, TactileTaskEnv
from ..vision.camera import Sight

FloatArray = NDArray[np.float64]
NextAction = Callable[[Observation, Info], NDArray[np.float32] | None]
Belief = Callable[[int], NDArray[np.float32] | None]
"""Return the offset [mm, deg], of this length, that a policy believed in at its last look; None without a belief."""

TRUE_OFFSET = "gt_offset_mm_deg"
"""Key of the info of tasks whose held part has an offset: what a policy may say what it believes of."""


class Pace(StrEnum):
    """How often a moment is recorded."""

    ENV_STEP = "env-step"  # after the reset and after each env step
    IPC_STEP = "ipc-step"  # also after each IPC step within an env step


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """The scene at one time; within an env step, observation and info are those before it.

    Places are in the world or, where the fixed part moves, in a frame that moves with it.

    Attributes:
        env_step: number of the env step that ends at this moment or later; 0 after the reset.
        gel_nodes_m: all nodes of the left and the right gel [m], shapes [n, 3].
        sensor_poses: of the left and the right sensor.
        held_m: vertices of the held part [m], shape [v, 3].
        marker_flow: what the policy was given [pixel], shape [2, 2, 128, 2].
        lost_px: where markers were that it lost, of the left and the right sensor [pixel], shapes [l, 2].
        info: of the last reset or env step that has ended.
        contact_forces_n: on the held part, the left and the right gel [N], shape [3, 3].
        pair_forces: of single contacts.
        fixed_shift_m: how far the fixed part has moved in the world [m], shape [3].
        sight: what the camera rig saw then; None where there is none.
        belief_error: what the policy believed of the offset at its last look, less what was true then [mm, deg]; None
            where it has not said.
    """

    env_step: int
    gel_nodes_m: tuple[FloatArray, FloatArray]
    sensor_poses: tuple[SensorPose, SensorPose]
    held_m: FloatArray
    marker_flow: NDArray[np.float32]
    lost_px: Sequence[FloatArray]
    info: Mapping[str, Any]
    contact_forces_n: FloatArray
    pair_forces: PairForces
    fixed_shift_m: FloatArray
    sight: Sight | None = None
    belief_error: FloatArray | None = None

    @property
    def believed(self) -> FloatArray | None:
        """Where the held part is now if the target is where the policy believed it at its last look [mm, deg]."""
        if self.belief_error is None:
            return None
        return np.asarray(self.info[TRUE_OFFSET]) + self.belief_error

    @property
    def end_reason(self) -> str | None:
        """Why the episode has ended, or None while it is running."""
        reason: str | None = self.info["end_reason"]
        return reason


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodePlayback:
    """What does not change in an episode, and its moments in order.

    Attributes:
        env_id: registered id of the environment.
        gel: mesh of both gels, in their own frame.
        camera: intrinsics of both sensors.
        physics: materials of the gels.
        held: the part in the grasp, in its own frame.
        measured: its vertices by whose heights success is judged, in their order; empty where the task names none.
        fixed: the part it goes into.
        fixed_m: vertices of that part in the world [m], shape [v, 3].
        moments: at least one.
        actions: of the env steps that were played, shape [n, a].
        rewards: of these env steps, shape [n].
        plotted: observables with curves, whose values are in the info of each moment.
    """

    env_id: str
    gel: GelMesh
    camera: CameraIntrinsics
    physics: PhysicsSettings
    held: SurfaceMesh
    measured: NDArray[np.int64]
    fixed: SurfaceMesh
    fixed_m: FloatArray
    moments: tuple[Moment, ...]
    actions: NDArray[np.float32]
    rewards: FloatArray
    plotted: tuple[Observable[Any], ...] = ()

    @property
    def last_moments(self) -> tuple[int, ...]:
        """Index of the moment at which each env step ends, the reset first."""
        steps = [moment.env_step for moment in self.moments]
        return tuple(index for index, step in enumerate(steps) if step not in steps[index + 1 :])

    @property
    def looks(self) -> tuple[Moment, ...]:
        """Moments at which an action was chosen; a policy does not look at the end."""
        return tuple(self.moments[index] for index in self.last_moments[: len(self.actions)])


def record(
    env: TactileTaskEnv[Any, Any],
    *,
    options: Mapping[str, Any],
    next_action: NextAction,
    pace: Pace = Pace.ENV_STEP,
    belief: Belief | None = None,
) -> EpisodePlayback:
    """Play an episode until it ends or no action comes, and keep it.

    Args:
        env: environment of a tactile task; it is reset here.
        options: of the reset.
        next_action: gives the action for an observation and the info with it, or None to stop.
        pace: how often a moment is kept.
        belief: is asked after each action, where the task has an offset.
    """
    observation, info = env.reset(options=dict(options))
    moments = [_moment(env.scene, 0, observation, info, _sight(env))]
    actions: list[NDArray[np.float32]] = []
    rewards: list[float] = []
    while info["end_reason"] is None:
        action = next_action(observation, info)
        if action is None:
            break
        if belief is not None and TRUE_OFFSET in info:
            moments[-1] = _add_belief(moments[-1], belief(len(info[TRUE_OFFSET])))
        number, error = moments[-1].env_step + 1, moments[-1].belief_error
        if pace is Pace.IPC_STEP:
            env.scene.after_ipc_step = partial(_keep, moments, env.scene, number, observation, info)
        observation, reward, _, _, info = env.step(action)
        env.scene.after_ipc_step = None
        actions.append(action)
        rewards.append(reward)
        ended = replace(_moment(env.scene, number, observation, info, _sight(env)), belief_error=error)
        if pace is Pace.IPC_STEP:
            moments[-1] = ended  # The last IPC step ends the env step.
        else:
            moments.append(ended)
    return _playback(env, tuple(moments), actions, rewards)


def _keep(moments: list[Moment], scene: GraspedScene, env_step: int, observation: Observation, info: Info) -> None:
    made = _moment(scene, env_step, observation, info, moments[-1].sight)
    moments.append(replace(made, belief_error=moments[-1].belief_error))


def _add_belief(moment: Moment, believed: NDArray[np.float32] | None) -> Moment:
    """Return a moment with what the policy believes from now on; the same where it does not say."""
    return moment if believed is None else replace(moment, belief_error=believed - moment.info[TRUE_OFFSET])


def _sight(env: TactileTaskEnv[Any, Any]) -> Sight | None:
    """Return what the rig of the scene sees now; None where the task has none."""
    look = getattr(env.task_scene, "sight", None)
    return None if look is None else look()


def _moment(scene: GraspedScene, env_step: int, observation: Observation, info: Info, sight: Sight | None) -> Moment:
    shift_m, left, right, pairs = (
        scene.fixed_shift_m(),
        scene.sensor_pose(0),
        scene.sensor_pose(1),
        scene.pair_forces(),
    )
    return Moment(
        env_step=env_step,
        gel_nodes_m=(scene.gel_nodes_m(0) - shift_m, scene.gel_nodes_m(1) - shift_m),
        sensor_poses=(
            replace(left, centre_m=left.centre_m - shift_m),
            replace(right, centre_m=right.centre_m - shift_m),
        ),
        held_m=scene.held_vertices_m(np.arange(len(scene.held_surface.vertices_m))) - shift_m,
        marker_flow=observation["marker_flow"],
        lost_px=scene.lost_markers_px(),
        info=info,
        contact_forces_n=scene.contact_forces_n(),
        pair_forces=pairs._replace(points_m=pairs.points_m - shift_m),
        fixed_shift_m=shift_m,
        sight=sight,
    )


def _playback(
    env: TactileTaskEnv[Any, Any], moments: tuple[Moment, ...], actions: list[NDArray[np.float32]], rewards: list[float]
) -> EpisodePlayback:
    scene = env.scene
    fixed = scene.fixed_surface()
    return EpisodePlayback(
        env_id=env.env_id,
        gel=scene.gel,
        camera=scene.camera,
        physics=scene.physics,
        held=scene.held_surface,
        measured=getattr(env.task_scene, "measured_vertices", np.zeros(0, dtype=np.int64)),
        fixed=fixed,
        fixed_m=fixed.vertices_m,
        moments=moments,
        actions=np.array(actions, dtype=np.float32).reshape(-1, len(env.task.actions)),
        rewards=np.array(rewards, dtype=np.float64),
        plotted=env.plotted_observables,
    )
