"""Checks a track file that an organizer wrote, and measures what an evaluation on it costs; needs no service."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from numpy.typing import NDArray
from vitac.envs.tasks.definition import Family
from vitac.errors import VitacError
from vitac.evaluator.episodes.episode import Environment, make_environment
from vitac.evaluator.strict_model import DocumentRejected, read_yaml
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Episode, ListKind, Player, Task, Track, list_tracks, load_track
from vitac.evaluator.tracks.definition import cut

CORES = 2
"""Number of cores for which the wall time is given."""


@dataclass(frozen=True, kw_only=True)
class TaskCost:
    """What it costs to evaluate a submission on one task, besides what its policy computes.

    Attributes:
        shards: that workers take one by one.
        played: episodes that were played to measure it.
        cpu_s: of all episodes [s]; None where it cannot be measured here.
        wall_s: with `CORES` cores [s].
        note: why it was not measured.
    """

    task: str
    env_id: str
    episodes: int
    shapes: tuple[str, ...]
    list_kind: ListKind
    shards: int
    played: int
    cpu_s_per_episode: float | None
    cpu_s: float | None
    wall_s: float | None
    note: str | None


@dataclass(frozen=True, kw_only=True)
class CheckedTrack:
    """A track file that can be put into VITAC_TRACKS_DIR."""

    name: str
    title: str
    accepts: tuple[SubmissionKind, ...]
    tasks: tuple[TaskCost, ...]


def check_track(path: Path) -> CheckedTrack:
    """Check a track file by playing a few of its episodes: every shape once, and the largest offsets.

    Raises:
        DocumentRejected: with one sentence for each thing that is wrong.
    """
    track = read_yaml(Track, path)
    problems = list(_problems(track, path))
    costs = []
    for task in track.tasks.values():
        try:
            costs.append(_cost(track, task))
        except VitacError as error:
            problems.append(f"tasks.{task.name}: {error}")
    if problems:
        raise DocumentRejected(f"{path.name}: {' '.join(problems)}")
    return CheckedTrack(name=track.name, title=track.title, accepts=track.accepts, tasks=tuple(costs))


def _problems(track: Track, path: Path) -> Iterator[str]:
    if track.name != path.stem:
        yield f"name is {track.name!r}, expected {path.stem!r}, the name of the file."
    others = [load_track(name) for name in list_tracks()]
    same = next((other for other in others if other.name == track.name), None)
    if same is not None and same != track:
        yield f"name: there is a track {track.name!r} already; choose another name."
    taken = {task: other.name for other in others if other.name != track.name for task in other.tasks}
    for task in track.tasks.keys() & taken.keys():
        yield f"tasks.{task}: {taken[task]} has a task of that name; choose another one."
    lists = {task.episode_list.kind for task in track.tasks.values()}
    if ListKind.SEALED in lists and not all(kind.form.runs_policy for kind in track.accepts):
        yield "accepts: a sealed list takes models only; a log would need the episodes that nobody knows."
    if SubmissionKind.TEXT_LOG in track.accepts and not any(task.name_2025 for task in track.tasks.values()):
        yield "accepts: text_log needs a task with name_2025, which text logs name."


def _cost(track: Track, task: Task) -> TaskCost:
    shards, sample = len(cut(task)), _sample(task)
    note = _explain_not_played(track, task)
    each = _seconds(task, sample) if note is None else None
    total = None if each is None else each * len(task.episodes)
    return TaskCost(
        task=task.name,
        env_id=task.env_id,
        episodes=len(task.episodes),
        shapes=task.episode_list.shapes,
        list_kind=task.episode_list.kind,
        shards=shards,
        played=len(sample) if each is not None else 0,
        cpu_s_per_episode=each,
        cpu_s=total,
        wall_s=None if total is None else total / min(CORES, shards),
        note=note,
    )


def _explain_not_played(track: Track, task: Task) -> str | None:
    if track.has_sensor or task.player is not Player.POLICY:
        return "it depends on the sensors that teams bring"
    if task.family is Family.STATION:
        return "it is played on a station"
    if task.definition.family is not Family.TACTILE:
        return "environments of ManiSkill are not played here"
    return None


def _sample(task: Task) -> list[Episode]:
    """Return the first episode of every shape, and those with the smallest and largest of each number of the offset."""
    chosen: dict[int, Episode] = {}
    for shape in task.episode_list.shapes:
        first = next(episode for episode in task.episodes if episode.shape == shape)
        chosen[first.number] = first
    for index in range(len(task.episodes[0].offset)):
        for extreme in (min, max):
            episode_at_end = extreme(task.episodes, key=lambda episode: episode.offset[index])
            chosen[episode_at_end.number] = episode_at_end
    return [chosen[number] for number in sorted(chosen)]


def _seconds(task: Task, sample: list[Episode]) -> float:
    """Return the CPU time of an episode [s] that lasts as long as it can, with motions as policies make them.

    Each env step costs what it costs on average with random actions of half the range. At rest it costs half of that.
    """
    env = make_environment(task, None, ())
    for episode in sample:
        _require_end(env, task, episode)  # compiles what is not compiled yet, too
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (task.max_steps, len(task.actions))).astype(np.float32)
    reset_s = steps_s = 0.0
    n_steps = 0
    for episode in sample:
        started = process_time()
        env.reset(options=episode.options)
        reset_s += process_time() - started
        started = process_time()
        n_steps += _play(env, actions)
        steps_s += process_time() - started
    return reset_s / len(sample) + task.max_steps * steps_s / n_steps


def _require_end(env: Environment, task: Task, episode: Episode) -> None:
    env.reset(options=episode.options)
    if _play(env, np.zeros((task.max_steps + 1, len(task.actions)), np.float32)) > task.max_steps:
        raise DocumentRejected(
            f"Episode {episode.number} does not end within max_steps = {task.max_steps} env steps; give the "
            "environment's own limit, or set it among the settings, too."
        )


def _play(env: Environment, actions: NDArray[np.float32]) -> int:
    """Return how many of the actions were played, up to the end of the episode."""
    for count, action in enumerate(actions, start=1):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return count
    return len(actions)
