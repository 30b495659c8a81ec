"""Our tasks as a benchmark of vla-eval: `benchmark: "vitac.integrations.vla_eval:ViTac"` in the YAML of `vla-eval run`.

The harness asks for each env step, the evaluator asks for each action: an episode runs in a thread, which waits for the
harness. So the records are those of `vitac evaluate`, and so is the result hash.
"""

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.agent.protocol import CloudSpec, add_clouds, checked_action
from vitac.evaluator.agent.verdicts import EpisodeCut
from vitac.evaluator.episodes.episode import make_environment, run_episode
from vitac.evaluator.episodes.records import EpisodeRecord, make_manifest, make_reading, result_hash
from vitac.evaluator.logs.log import LogHeader, write_log
from vitac.evaluator.remote.codec import read_array
from vitac.evaluator.remote.description import RemoteProtocol, RemoteServer, by_level
from vitac.evaluator.tracks import Episode, load_track
from vla_eval.benchmarks.base import StepBenchmark, StepResult
from vla_eval.specs import DimSpec

logger = logging.getLogger("vla_eval.vitac")  # below the harness's own, which it shows


class ViTac(StepBenchmark):  # type: ignore[misc]  # vla-eval is not in our environment
    """The public episodes of a task, each a task of the harness that is played once (`episodes_per_task: 1`).

    Args:
        track: its name.
        task: its name.
        episodes: their numbers; all by default.
        observations: what is sent by name, as in `remote` of submission.yaml; all by default.
        prompt: the task in words; its name by default.
        log: file for a log of all episodes, which `vitac log verify` reads.
    """

    render_backends: ClassVar[frozenset[str]] = frozenset({"gpu", "cpu"})

    def __init__(
        self,
        track: str = "track_1",
        task: str = "peg-insertion",
        episodes: Sequence[int] | None = None,
        observations: Mapping[str, Any] | None = None,
        prompt: str = "",
        log: str | None = None,
    ) -> None:
        super().__init__()
        self._track = load_track(track)
        self._definition = self._track.tasks[task]
        self._episodes = {
            episode.number: episode
            for episode in self._definition.episodes
            if episodes is None or episode.number in episodes
        }
        self._server = RemoteServer.model_validate(
            {"protocol": RemoteProtocol.VLA_EVAL, "observations": observations, "prompt": prompt}
        )
        self._reading = make_reading(self._definition, self._server.keys)
        self._env = make_environment(self._definition, None, self._reading.sent)
        self._log = log
        self._playing: _Playing | None = None
        self._records: dict[int, EpisodeRecord] = {}

    @classmethod
    def configure_render(cls, mode: str) -> dict[str, str]:  # noqa: ARG003 - as the harness calls it
        """Set nothing: pictures are drawn on the CPU, with the same bits everywhere."""
        return {}

    def get_tasks(self) -> list[dict[str, Any]]:
        """Return a task for each episode, by the number that it has in our lists."""
        name = self._definition.name
        return [{"name": f"{name}-{number}", "suite": name, "episode": number} for number in self._episodes]

    def get_metadata(self) -> dict[str, Any]:
        """Return how many env steps an episode has at most."""
        return {"max_steps": self._definition.max_steps}

    def get_action_spec(self) -> dict[str, DimSpec]:
        """Return what an action is."""
        size = len(self._definition.actions)
        return {"action": DimSpec("action", size, f"vitac_{self._definition.name}", range=(-1.0, 1.0))}

    def get_observation_spec(self) -> dict[str, DimSpec]:
        """Return what is sent, by the keys of our tables."""
        return {
            row.name: DimSpec(row.name, int(np.prod(row.shape)), f"{row.dtype} [{row.unit}]", description=row.meaning)
            for row in self._definition.observables
            if row.name in self._reading.keys
        }

    def reset(self, task: Mapping[str, Any]) -> Mapping[str, NDArray[Any]]:
        """Begin an episode."""
        self._leave()
        self._playing = _Playing(partial(self._play, self._episodes[task["episode"]]))
        observation = self._playing.next()
        if isinstance(observation, EpisodeRecord):
            raise RuntimeError(f"Expected an episode that begins, got one that is over: {observation.failure}.")
        return observation

    def step(self, action: Mapping[str, Any]) -> StepResult:
        """Play an env step."""
        if self._playing is None:
            raise RuntimeError("Expected an episode that was begun by reset, got none.")
        self._playing.actions.put(action)
        outcome = self._playing.next()
        if not isinstance(outcome, EpisodeRecord):
            return StepResult(obs=outcome, reward=0.0, done=False, info={})
        self._records[outcome.episode] = outcome
        return StepResult(obs=None, reward=outcome.total_reward, done=True, info={"record": outcome})

    def make_obs(
        self,
        raw_obs: Mapping[str, NDArray[Any]],
        task: Mapping[str, Any],  # noqa: ARG002 - as the harness calls it
    ) -> dict[str, Any]:
        """Return the observation as the model server names it, with the prompt."""
        named = by_level(self._server.names(add_clouds(self._reading.clouds, raw_obs)))
        return named | {"task_description": self._server.prompt or self._definition.name}

    def get_step_result(self, step_result: StepResult) -> dict[str, Any]:
        """Return whether the episode was a success, and how it ended."""
        record = step_result.info.get("record")
        return {
            "success": record is not None and record.success,
            "outcome": "none" if record is None else str(record.outcome),
        }

    def cleanup(self) -> None:
        """Say the result hash, and write the log."""
        self._leave()
        records = list(self._records.values())
        manifest = make_manifest(self._track, self._definition, self._env)
        logger.info("result hash of %d episodes %s", len(records), result_hash(manifest, records))
        if self._log is not None:
            with Path(self._log).open("wb") as stream:
                write_log(stream, LogHeader(manifest=manifest), sorted(records, key=lambda record: record.episode))

    def _play(self, episode: Episode, playing: "_Playing") -> EpisodeRecord:
        return run_episode(
            env=self._env,
            task=self._definition,
            episode=episode,
            open_session=lambda: playing,
            reading=self._reading,
        )

    def _leave(self) -> None:
        """End an episode that the harness does not play to its end."""
        if self._playing is not None:
            self._playing.leave()
        self._playing = None


class _Playing:
    """An episode in a thread of its own; to the evaluator it is the session and the policy of that episode."""

    isolation = None
    cpu_s = 0.0
    channel_s = 0.0
    answers_s: tuple[float, ...] = ()
    output = ""

    def __init__(self, play: Callable[["_Playing"], EpisodeRecord]) -> None:
        self.actions: SimpleQueue[Mapping[str, Any] | None] = SimpleQueue()
        self._outcomes: SimpleQueue[Mapping[str, NDArray[Any]] | EpisodeRecord | Exception] = SimpleQueue()
        self._shape: tuple[int, ...] = ()
        self._thread = threading.Thread(target=self._run, args=(play,), daemon=True)
        self._thread.start()

    def next(self) -> Mapping[str, NDArray[Any]] | EpisodeRecord:
        """Return what the env step gave: an observation, or the record of an episode that is over."""
        outcome = self._outcomes.get()
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def leave(self) -> None:
        """End the episode, unless it is over."""
        self.actions.put(None)
        self._thread.join()

    def begin_shard(self) -> None:
        """Do nothing: the harness has no shards."""

    @contextlib.contextmanager
    def episode(
        self,
        *,
        task: str,  # noqa: ARG002 - the harness knows it
        action_shape: tuple[int, ...],
        clouds: Sequence[CloudSpec] = (),  # noqa: ARG002 - `make_obs` makes them
    ) -> Iterator["_Playing"]:
        """Give the policy: what the harness brings."""
        self._shape = action_shape
        yield self

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Hand the observation to the harness and wait for its action.

        Raises:
            PolicyFailed: the action is none.
            EpisodeCut: the harness has left the episode.
        """
        self._outcomes.put(observation)
        action = self.actions.get()
        if action is None:
            raise EpisodeCut("The harness left the episode before its end.")
        return checked_action({"action": read_array(action["actions"])}, self._shape)

    def _run(self, play: Callable[["_Playing"], EpisodeRecord]) -> None:
        try:
            self._outcomes.put(play(self))
        except Exception as error:  # noqa: BLE001 - whoever waits raises it
            self._outcomes.put(error)
