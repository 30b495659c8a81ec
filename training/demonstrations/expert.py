"""An expert that knows the truth of one task, and tries plans in the simulation until one succeeds.

Collecting demonstrations uses it, and the benchmarks of the variants.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pkgutil import resolve_name
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.scene.measured_pose import held_pose_mm_deg
from vitac.errors import VitacError
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.tracks import Task

_DONE = 0.05


class NoExpert(VitacError):
    """A task says no way to its target; give its definition a `guided_motion`."""


@dataclass(frozen=True, kw_only=True)
class ExpertPlan:
    """How to go to the target.

    Attributes:
        gain: part of the way that is left, gone in every env step.
        measured: whether the way begins where the part is measured to be, not where it is commanded to be.
        last_waits: whether the last number of an action, such as the lift of a key, waits until the others are done.
        spread: standard deviation of what is added to every number of an action.
        noisy_steps: number of the first env steps in which it is added; afterwards the expert recovers. None for all.
        bias: what is added to every action of the episode: the expert goes to a place beside the target.
        seed: of what is added.
    """

    gain: float
    measured: bool
    last_waits: bool = False
    spread: float = 0.0
    noisy_steps: int | None = None
    bias: tuple[float, ...] = ()
    seed: tuple[int, ...] = (0,)


PLANS = (
    *(ExpertPlan(gain=gain, measured=measured) for gain in (1.0, 0.6, 1.3) for measured in (False, True)),
    *(ExpertPlan(gain=gain, measured=True, last_waits=True) for gain in (1.0, 0.5)),
    *(ExpertPlan(gain=1.0, measured=True, spread=0.3, seed=(seed,)) for seed in range(10)),
)
"""What succeeds in nearly every episode, in the order in which it is tried."""


def add_noise(
    plans: Sequence[ExpertPlan], *, spread: float, noisy_steps: int, seed: tuple[int, ...]
) -> tuple[ExpertPlan, ...]:
    """Return the same plans with noise, each from a generator of its own."""
    return tuple(
        replace(plan, spread=spread, noisy_steps=noisy_steps, seed=(*seed, number)) for number, plan in enumerate(plans)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Rollout:
    """An episode that was played.

    Attributes:
        info: the last one.
        actions: shape [env steps, action size].
        state_hashes: of the reset, and after every env step.
        total_reward: of all env steps.
    """

    info: Mapping[str, Any]
    actions: NDArray[np.float32]
    state_hashes: tuple[str, ...]
    total_reward: float


class Expert:
    """Knows the exact offset and the exact parts.

    Args:
        task: that is played.
        observation_keys: what is observed beside the truth.
        settings: in place of the task's own.

    Raises:
        NoExpert: the task says no way to its target.
    """

    def __init__(self, task: Task, observation_keys: Sequence[str] = (), **settings: Any) -> None:
        if task.definition.guided_motion is None:
            raise NoExpert(f"{task.name} has no expert, expected a task whose definition has a guided_motion.")
        self.env: Any = make_environment(task, observation_keys=observation_keys, settings=settings)
        self._way = resolve_name(task.definition.guided_motion)
        self._again = partial(Expert, task, tuple(observation_keys), **settings)

    def __reduce__(self) -> tuple[Any, ...]:
        """Make another one where it is sent to; an environment stays in its process."""
        return self._again, ()

    def play(self, options: Mapping[str, Any], plans: Sequence[ExpertPlan] = PLANS) -> Rollout:
        """Play the first plan that succeeds, or the last."""
        _, start = self.env.reset(options=options)
        snapshot = self.env.snapshot()
        for plan in plans:
            self.env.restore(snapshot)
            played = self._follow(plan, start)
            if played.info["is_success"]:
                break
        return played

    def _follow(self, plan: ExpertPlan, info: Mapping[str, Any]) -> Rollout:
        random = np.random.default_rng(plan.seed)
        actions, state_hashes, total_reward = [], [self.env.state_hash()], 0.0
        while info["end_reason"] is None:
            actions.append(self.act(plan, info, random))
            _, reward, _, _, info = self.env.step(actions[-1])
            state_hashes.append(self.env.state_hash())
            total_reward += float(reward)
        return Rollout(
            info=info,
            actions=np.array(actions, dtype=np.float32).reshape(len(actions), -1),
            state_hashes=tuple(state_hashes),
            total_reward=total_reward,
        )

    def act(self, plan: ExpertPlan, info: Mapping[str, Any], random: np.random.Generator) -> NDArray[np.float32]:
        """Return the next action of a plan."""
        way = plan.gain * self._way({}, self.measure(info) if plan.measured else info)
        if plan.last_waits and np.abs(way[:-1]).max() > _DONE:
            way[-1] = 0.0
        if plan.noisy_steps is None or info["steps"] < plan.noisy_steps:
            way = way + plan.spread * random.standard_normal(len(way))
        return np.asarray(np.clip(way + np.array(plan.bias or 0.0), -1.0, 1.0), dtype=np.float32)

    def measure(self, info: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the info of an insertion with the offset of the peg's lower end in place of the commanded one."""
        if "gt_offset_mm_deg" not in info:
            return info  # The info of the lock has measured teeth.
        scene = self.env.task_scene
        x_mm, y_mm, _, _, _, theta_deg = held_pose_mm_deg(scene.grasped)
        target = getattr(scene, "target", None)
        offset = info["gt_offset_mm_deg"].copy()
        offset[:3] = x_mm, y_mm - (target.y_mm if target else 0.0), theta_deg
        return {**info, "gt_offset_mm_deg": offset}
