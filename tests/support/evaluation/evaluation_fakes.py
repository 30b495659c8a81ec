"""A small task, an environment and policies that stand in for simulation and sandbox in tests of the evaluator."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.agent.isolation.bubblewrap import UserIsolation
from vitac.evaluator.agent.isolation.cgroup import MemoryIsolation
from vitac.evaluator.agent.isolation.memory_files import FileIsolation
from vitac.evaluator.agent.session import EpisodeIsolation, Isolation
from vitac.evaluator.agent.verdicts import PolicyFailed, VerdictCode
from vitac.evaluator.tracks import Task, Track, load_track
from vitac.evaluator.tracks.definition import EpisodeBlock

Answer = Callable[[int, int], NDArray[np.float32]]


def small_track(repeats: int = 1, shard_size: int = 4, offsets: int = 4) -> Track:
    """Track 1 with a list of `repeats` x `offsets` x 3 episodes."""
    track = load_track("track_1")
    task = track.tasks["peg-insertion"]
    block = EpisodeBlock(repeats=repeats, starts=task.episode_list.starts[: 3 * offsets])
    episode_list = task.episode_list.model_copy(update={"blocks": (block,)})
    # A new one, not a copy: that would bring the whole list along once somebody has asked for it.
    small = Task(**{**task.model_dump(), "episode_list": episode_list, "shard_size": shard_size})
    return track.model_copy(update={"tasks": {"peg-insertion": small}})


class FakeEnvironment:
    """Ends with success at the first action whose x is 1, with too many steps after 8; its state hashes its history.

    Args:
        camera: name of the camera whose pictures show the history; none by default.
    """

    solver_version = "fake"

    def __init__(self, camera: str | None = None) -> None:
        self.camera = camera
        self.pictures_taken = 0
        self.ipc_steps = 0
        self.physics_cpu_s = 0.0
        self.marker_cpu_s = 0.0
        self.extra_observation: dict[str, NDArray[Any]] = {}
        self.endless = False
        self._history = b""
        self._steps = 0

    def mesh_hash(self) -> str:
        return "0" * 64

    def state_hash(self) -> str:
        return hashlib.sha256(self._history).hexdigest()

    def picture_hash(self) -> str | None:
        self.pictures_taken += 1
        return hashlib.sha256(self.camera.encode() + self._history).hexdigest() if self.camera else None

    def reset(self, *, options: Mapping[str, object]) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        self._history, self._steps = repr(sorted(options.items())).encode(), 0
        self.physics_cpu_s += 0.25
        self.ipc_steps += 4
        return self._observation(), {}

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        self._history += action.tobytes()
        self._steps += 1
        self.physics_cpu_s += 0.5
        self.ipc_steps += 3
        self.marker_cpu_s += 0.125
        success = bool(action[0] == 1) and not self.endless
        too_many = self._steps >= 8 and not self.endless
        end_reason = "success" if success else "steps" if too_many else None
        info = {
            "steps": self._steps,
            "surface_diff_m": np.array([1e-3, 2e-3]),
            "is_success": np.bool_(success),
            "end_reason": end_reason,
            "step_reports": (),
        }
        return self._observation(), float(action.sum()), success, too_many, info

    def _observation(self) -> dict[str, NDArray[Any]]:
        return {
            "marker_flow": np.zeros((2, 2, 128, 2), np.float32),
            "relative_motion": np.array([0, 0, 0, self._steps], np.float32),
            **self.extra_observation,
        }


class FakePolicy:
    """Asks `answer(started episodes, env step)` for each action."""

    cpu_s = 0.0625
    channel_s = 0.03125
    answers_s = ()
    output = "I am thinking.\n"

    def __init__(self, answer: Answer, started: int) -> None:
        self._answer, self._started, self._step = answer, started, 0

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        self._step += 1
        return self._answer(self._started, self._step)


class FakeSession:
    """A loaded policy; counts the episodes it has started and says whether it is open.

    Args:
        answer: gives its actions.
        plays: the task, and the shape of its actions.
    """

    isolation = Isolation(
        user=UserIsolation.ROOT,
        memory=MemoryIsolation.WATCHDOG,
        episodes=EpisodeIsolation.FRESH_PROCESS,
        files=FileIsolation.DISK,
        process_ids_repeat=False,
    )

    def __init__(self, answer: Answer, plays: tuple[str, tuple[int, ...]] = ("peg-insertion", (3,))) -> None:
        self.answer = answer
        self.plays = plays
        self.shards = 0
        self.started = 0
        self.open = False
        self.loads = 0

    @contextmanager
    def load(self, *_: object) -> Iterator["FakeSession"]:
        """Stands in for the sandbox."""
        self.loads += 1
        self.open = True
        try:
            yield self
        finally:
            self.open = False

    def begin_shard(self) -> None:
        self.shards += 1

    @contextmanager
    def episode(self, *, task: str, action_shape: tuple[int, ...], clouds: object = ()) -> Iterator[FakePolicy]:
        assert self.open
        assert (task, action_shape) == self.plays
        self.started += 1
        yield FakePolicy(self.answer, self.started)


def action(x: float) -> NDArray[np.float32]:
    return np.array([x, 0, 0], dtype=np.float32)


def succeed(_: int, step: int) -> NDArray[np.float32]:
    """Solves the task at the third env step."""
    return action(1.0 if step == 3 else 0.5)


def fail(*_: object) -> NDArray[np.float32]:
    """Crashes at once."""
    raise PolicyFailed(VerdictCode.CRASHED, "It ended with signal 11.", "Segmentation fault")


@contextmanager
def cannot_load(*_: object) -> Iterator[FakeSession]:
    """Stands in for the sandbox of a submission that cannot be imported."""
    raise PolicyFailed(VerdictCode.IMPORT_ERROR, "No module named 'torch'.")
    yield FakeSession(succeed)
