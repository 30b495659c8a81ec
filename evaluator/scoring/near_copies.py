"""Whether two evaluations of one episode list are so alike that one was made from the other; called by the service.

Two policies that were made apart see the same noise and still act differently in most episodes; recorded actions that
were changed a little, and weights with a little noise, do not. Paths are compared whatever the time they take: of
actions that were cut in two, or begin later, the states remain. What everybody does in every episode, and actions at
their limits, are no evidence.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Actions = NDArray[np.float32]
"""The first actions of each episode, shape [episodes, TRACED_STEPS, action size]; NaN after the end of an episode."""
Paths = NDArray[np.float32]
"""States along each episode's commanded way, one every `PATH_STEP` of it, shape [episodes, PATH_POINTS, numbers].

NaN after the end of the way; no numbers where a task's infos have none.
"""

TRACED_STEPS: Final = 8
TOLERANCE: Final = 0.02
"""Difference of an action, in [-1, 1], and of the motion that was commanded until then, of which a copy stays below."""
MAX_DELAY: Final = 2
"""Maximum delay of a copy's motion in env steps, after actions that move hardly anything."""
PATH_POINTS: Final = 12
PATH_STEP: Final = 0.5
"""Way between two points of a path [mm, deg]."""
PATH_TOLERANCE: Final = 0.1
"""Difference of any number of a state [mm, deg] of which a copy stays below."""
_FEWEST_POINTS: Final = 4
"""Minimum number of points of both ways, which begin at the same place."""
_MEASURED_SCALE: Final = 0.2
"""What is measured of gels and part may differ by 0.5 mm: it depends on the time, too."""
_GELS: Final = 2
_AT_LIMIT: Final = 0.999
_FEWEST_VALUES: Final = 2
"""Minimum number of actions that only this episode has, for a comparison to say something."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """What an evaluation is compared by."""

    actions: Actions
    paths: Paths


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """How alike two evaluations are.

    Attributes:
        episodes: that both have and that say something.
        near: those of them whose actions, commanded motions or states are within the tolerance; equal ones count once.
        difference: median over the episodes of the largest difference of an action.
    """

    episodes: int
    near: int
    difference: float

    @property
    def is_copy(self) -> bool:
        """Whether one was made from the other: half of the episodes or more are near."""
        return self.near > 0 and 2 * self.near >= self.episodes


def make_trace(
    actions: Sequence[NDArray[np.float32]], size: int, infos: Sequence[Sequence[Mapping[str, Any]]]
) -> Trace:
    """Return the trace of episodes.

    Args:
        actions: of each episode of a list, in their order, shape [env steps, size].
        size: of an action.
        infos: of the same episodes, one for each env step.
    """
    trace = np.full((len(actions), TRACED_STEPS, size), np.nan, np.float32)
    for row, of_episode in zip(trace, actions, strict=True):
        played = of_episode[:TRACED_STEPS].reshape(-1, size)
        row[: len(played)] = played
    first = next((of_episode[0] for of_episode in infos if of_episode), {})
    numbers = len(_measured(first)) + len(_motion(first)) if _motion(first) else 0
    return Trace(actions=trace, paths=np.stack([_path(of_episode, numbers) for of_episode in infos]))


def compare_traces(first: Trace, second: Trace) -> Likeness:
    """Return how alike two evaluations of the same episodes are, the first one being the earlier one."""
    earlier, later = first.actions, second.actions
    if earlier.shape != later.shape or not earlier.size:
        return Likeness(episodes=0, near=0, difference=np.inf)
    own = _own_values(earlier)
    says_something = own.sum(axis=(1, 2)) >= _FEWEST_VALUES
    differences = _largest(earlier - later)
    alike = (differences <= TOLERANCE) | _moves_alike(earlier, later) | _same_way(first, second)
    near = says_something & alike
    rows = np.where(own, earlier, 0.0)[near].round(3) + 0.0
    return Likeness(
        episodes=int(says_something.sum()),
        near=len(np.unique(rows.reshape(len(rows), -1), axis=0)) if near.any() else 0,
        difference=float(np.median(differences[says_something])) if says_something.any() else np.inf,
    )


def _motion(info: Mapping[str, Any]) -> list[float]:
    """Return the commanded motion since the reset [mm, deg]; without an insertion's height, which goes with time."""
    return [float(number) for key in info if key.startswith("relative_motion") for number in info[key][:3]]


def _measured(info: Mapping[str, Any]) -> list[float]:
    """Return what was measured [mm]: mean motion of the gels' marked faces, and where a key's teeth are."""
    columns = [1e3 * np.asarray(info["surface_diff_m"], float)] if "surface_diff_m" in info else []
    columns += [1e3 * np.mean(info[key], axis=0) for key in sorted(info) if re.fullmatch(r"key\w+_pts_m", key)]
    return np.concatenate(columns).tolist() if columns else []


def _path(infos: Sequence[Mapping[str, Any]], numbers: int) -> NDArray[np.float32]:
    """Return the states of an episode along its commanded way, whatever the time that it takes."""
    points = np.full((PATH_POINTS, numbers), np.nan, np.float32)
    if not infos or not numbers:
        return points
    motion = np.array([_motion(info) for info in infos])
    motion = np.concatenate([np.zeros((1, motion.shape[1])), motion])
    measured = np.array([_measured(info) for info in infos])
    measured = _MEASURED_SCALE * np.concatenate([measured[:1], measured])
    if "surface_diff_m" in infos[0]:
        measured[0, :_GELS] = 0.0  # it counts from the reset on
    way = np.concatenate([[0.0], np.linalg.norm(np.diff(motion, axis=0), axis=1).cumsum()])
    at = PATH_STEP * np.arange(1, PATH_POINTS + 1)
    states = np.concatenate([motion, measured], axis=1)
    points[:] = np.stack([np.interp(at, way, column, right=np.nan) for column in states.T], axis=1)
    return points


def _same_way(earlier: Trace, later: Trace) -> NDArray[np.bool_]:
    """Return in which episodes both go through the same states."""
    if earlier.paths.shape != later.paths.shape or not earlier.paths.size:
        return np.zeros(len(earlier.actions), bool)
    differences = np.abs(earlier.paths - later.paths)
    enough = (~np.isnan(differences).all(axis=2)).sum(axis=1) >= _FEWEST_POINTS
    same: NDArray[np.bool_] = enough & (np.nan_to_num(differences).max(axis=(1, 2)) <= PATH_TOLERANCE)
    return same


def _own_values(trace: Actions) -> NDArray[np.bool_]:
    """Return which actions are neither at their limit nor what the policy does at that env step in every episode."""
    is_there = ~np.isnan(trace)
    first = np.where(is_there, trace, np.inf).min(axis=0)
    last = np.where(is_there, trace, -np.inf).max(axis=0)
    own: NDArray[np.bool_] = is_there & (np.abs(np.nan_to_num(trace)) < _AT_LIMIT) & (last - first > TOLERANCE)
    return own


def _moves_alike(earlier: Actions, later: Actions) -> NDArray[np.bool_]:
    """Return in which episodes the later one commands the earlier one's motion, perhaps some env steps later."""
    ours, theirs = (np.where(np.isnan(trace), 0.0, trace).cumsum(axis=1) for trace in (earlier, later))
    alike = np.zeros(len(earlier), bool)
    for delay in range(MAX_DELAY + 1):
        waits = np.abs(theirs[:, :delay]).max(axis=(1, 2), initial=0.0) <= TOLERANCE
        lead = np.where(np.isnan(earlier[:, : TRACED_STEPS - delay]), np.nan, ours[:, : TRACED_STEPS - delay])
        alike |= waits & (_largest(lead - theirs[:, delay:]) <= TOLERANCE)
    return alike


def _largest(differences: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the largest difference of each episode over the env steps that both have; infinite without any."""
    sizes = np.abs(differences)
    return np.where(np.isnan(sizes).all(axis=(1, 2)), np.inf, np.where(np.isnan(sizes), 0.0, sizes).max(axis=(1, 2)))
