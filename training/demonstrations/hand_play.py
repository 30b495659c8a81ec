"""Episodes that a person plays, each stored as a demonstration when it ends. Called by `vitac play`."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray
from vitac.envs.drawing.drawable import find_perspective
from vitac.envs.drawing.projection import section_loops_m
from vitac.envs.scene.perspective import Perspective
from vitac.envs.tasks.definition import Family
from vitac.errors import VitacError
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.episodes.records import ActionSequence, EpisodeOutcome, make_manifest
from vitac.evaluator.tracks import find_task

from ..streams import Use, stream
from .collecting import FILE, Demonstration, DemonstrationKind, Source, make_line, open_collection, read_demonstrations

FELT = ("marker_flow", "relative_motion")
"""What a person is shown of an observation, as far as the task has it."""


class NotPlayedByHand(VitacError):
    """A person cannot play the task, or an action does not fit; the message says why."""


class HandPlay:
    """A task in the hands of a person.

    Attributes:
        task: that is played.
        perspective: how its scene is looked at.
        control_rate_hz: env steps in a second while somebody moves the gripper.
    """

    def __init__(self, name: str, folder: Path, *, seed: int = 0) -> None:
        track, self.task = find_task(name)
        if self.task.family is not Family.TACTILE or track.has_sensor:
            raise NotPlayedByHand(f"{name} has no two gels of ours between which a part is held; choose another task.")
        self.perspective: Perspective = find_perspective(self.task.env_id)
        keys = [entry.name for entry in self.task.observables if entry.name in FELT]
        env = make_environment(self.task, observation_keys=keys)
        self._source = Source(manifest=make_manifest(track, self.task, env), stream=stream(seed, Use.PLAY_BY_HAND))
        self._env = cast("Any", env)
        self.control_rate_hz = float(self._env.metadata["render_fps"])
        self._path = folder / name / FILE
        self._file: BinaryIO | None = None
        self.stored: list[Demonstration] = []

    @contextmanager
    def storing(self) -> Iterator[Path]:
        """Hold the file of the demonstrations, begin an episode, and give the file's path.

        Raises:
            CollectionRejected: the file is of another seed or version, or an expert's.
            FolderInUse: another process writes there.
            NotSaved: it cannot be written.
        """
        with open_collection(self._path, self._source) as file:
            self._file, self.stored = file, list(read_demonstrations(self._path))
            self.begin()
            yield self._path

    def begin(self) -> None:
        """Begin the next episode; one that has not ended is not stored."""
        self.number = self.stored[-1].episode + 1 if self.stored else 1
        options = {"rng_seed": (self._source.stream, self.number)}
        self._observation, self._info = self._env.reset(options=options)
        self._actions: list[NDArray[np.float32]] = []
        self._state_hashes, self._total_reward, self._has_seen = [self._env.state_hash()], 0.0, False

    def step(self, action: Sequence[float]) -> None:
        """Play an env step; at the end of the episode it is stored.

        Raises:
            NotPlayedByHand: the action does not fit, or the episode has ended.
        """
        count = len(self.task.actions)
        if len(action) != count or not np.isfinite(action).all() or np.abs(action).max() > 1.0:
            raise NotPlayedByHand(f"Expected {count} numbers from -1 to 1, got {list(action)!s:.80}.")
        if self.end_reason is not None:
            raise NotPlayedByHand("The episode has ended; begin the next one.")
        self._actions.append(np.array(action, dtype=np.float32))
        self._observation, reward, _, _, self._info = self._env.step(self._actions[-1])
        self._state_hashes.append(self._env.state_hash())
        self._total_reward += float(reward)
        if self.end_reason is not None:
            self._store()

    @property
    def end_reason(self) -> str | None:
        """Why the episode has ended; None while it is running."""
        reason: str | None = self._info["end_reason"]
        return reason

    @property
    def env_steps(self) -> int:
        """Env steps of the running episode so far."""
        return len(self._actions)

    @property
    def motion(self) -> list[float] | None:
        """Commanded motion of the gripper since the start, as the policy sees it; None where it does not."""
        motion = self._observation.get("relative_motion")
        return None if motion is None else [round(float(value), 3) for value in motion]

    @property
    def markers_px(self) -> list[list[list[float]]]:
        """Markers of the left and the right gel, each u, v before and u, v now [pixel]; padding is left out."""
        gels = []
        for reference, current in self._observation["marker_flow"].astype(np.float64):
            count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
            gels.append(np.hstack([reference, current])[:count].round(2).tolist())
        return gels

    def scene_mm(self) -> dict[str, list[list[list[float]]]]:
        """Return both parts as the task's section shows them [mm]; who sees it, plays no longer by touch alone."""
        self._has_seen = True
        scene, view = self._env.scene, self.perspective.section
        fixed, held = scene.fixed_surface(), scene.held_surface
        held_m = scene.held_vertices_m(np.arange(len(held.vertices_m))) - scene.fixed_shift_m()
        axes = [index for index, _ in view.axes]
        parts = {
            "fixed": section_loops_m(fixed.vertices_m, fixed.triangles, view.fixed_cut),
            "held": section_loops_m(held_m, held.triangles, view.held_cut),
        }
        return {name: [(1e3 * loop[:, axes]).round(2).tolist() for loop in loops] for name, loops in parts.items()}

    def _store(self) -> None:
        assert self._file is not None  # noqa: S101 - episodes are played while the file is held
        played = Demonstration(
            episode=self.number,
            kind=DemonstrationKind.HUMAN_WITH_SCENE if self._has_seen else DemonstrationKind.HUMAN,
            shape=str(self._env.task_scene.shape),
            outcome=EpisodeOutcome(str(self.end_reason)),
            total_reward=self._total_reward,
            actions=ActionSequence.from_array(np.array(self._actions)),
            state_hashes=tuple(self._state_hashes),
        )
        self._file.write(make_line(played))
        self._file.flush()
        os.fsync(self._file.fileno())
        self.stored.append(played)
