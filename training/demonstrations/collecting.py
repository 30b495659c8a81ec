"""Demonstrations, the file that holds those of a task, and collecting them of an expert or of a submission's policy.

A demonstration is what is needed to play it again, and what was found: seed, actions and state hashes. What was seen is
not stored, because it follows from these (`frames`).
"""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from functools import partial
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal, Self

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt, ValidationError
from vitac.errors import VitacError
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.agent.verdicts import PolicyFailed
from vitac.evaluator.episodes.episode import Session, make_environment, open_episode, public_part
from vitac.evaluator.episodes.records import (
    ActionSequence,
    EpisodeOutcome,
    Manifest,
    StateHash,
    canonical_json,
    make_manifest,
    make_reading,
)
from vitac.evaluator.shards.policy import load_in_sandbox
from vitac.evaluator.strict_model import StrictModel, Word
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.submission.sources import staged, submission_digest
from vitac.evaluator.tracks import Task, Track, find_task, list_tracks, load_track

from ..files import not_saved
from ..folder_lock import hold_folder
from ..pool import map_in_order
from ..streams import Use, stream
from .expert import PLANS, Expert, ExpertPlan, Rollout, add_noise


class PolicyStopped(VitacError):
    """The policy failed in an episode; `vitac evaluate` says how often it does."""


class PolicyPlayer:
    """Plays a task by a policy, which each process that plays loads once.

    Args:
        track: of the task.
        task: that is played.
        submission: folder of the unpacked submission.
    """

    def __init__(self, track: Track, task: Task, submission: Path) -> None:
        self._reading = make_reading(task, load_manifest(submission).observation_keys)
        self.env: Any = make_environment(task, None, self._reading.sent)
        self._track, self._task, self._submission = track, task, submission
        self._exits = ExitStack()
        self._session: Session | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._exits.close()

    def play(self, options: Mapping[str, Any], *, spread: float, random: np.random.Generator) -> Rollout:
        """Play an episode.

        Args:
            options: of `reset`.
            spread: standard deviation of what is added to every number of an action.
            random: draws it.

        Raises:
            PolicyStopped: the policy failed.
            SandboxFailed: this machine cannot isolate it.
        """
        observation, info = self.env.reset(options=options)
        actions, state_hashes, total_reward = [], [self.env.state_hash()], 0.0
        try:
            with open_episode(self._load(), self._task, self._reading) as policy:
                while info["end_reason"] is None:
                    action = policy.act(public_part(self._task, self._reading, observation))
                    noisy = action + spread * random.standard_normal(len(action))
                    actions.append(np.asarray(np.clip(noisy, -1.0, 1.0), dtype=np.float32))
                    observation, reward, _, _, info = self.env.step(actions[-1])
                    state_hashes.append(self.env.state_hash())
                    total_reward += float(reward)
        except PolicyFailed as failure:
            raise PolicyStopped(f"The policy failed with {dict(options)}: {failure}") from failure
        return Rollout(
            info=info, actions=np.array(actions), state_hashes=tuple(state_hashes), total_reward=total_reward
        )

    def _load(self) -> Session:
        if self._session is None:
            session = load_in_sandbox(self._submission, Limits(), self._track.packages)
            self._session = self._exits.enter_context(session)
        self._session.begin_shard()
        return self._session


FILE = "demonstrations.jsonl"
"""Name of the file in the folder of a task."""


class CollectionRejected(VitacError):
    """A file of demonstrations is not what was written, or another task's; the message names the line."""


class DemonstrationKind(StrEnum):
    """Who acted, and how. Only the outcome says whether it succeeded."""

    CLEAN = "clean"
    """Its own actions; with noise only where nothing else succeeds."""
    NOISY = "noisy"
    """Its own actions, with noise in some of the first env steps, from which it recovers."""
    MISLED = "misled"
    """It goes to a place beside the target, which seldom succeeds."""
    POLICY = "policy"
    """A policy's own actions."""
    NOISY_POLICY = "noisy-policy"
    """A policy's actions with noise on each, which it feels."""
    HUMAN = "human"
    """A person played, by marker flow alone."""
    HUMAN_WITH_SCENE = "human-with-scene"
    """A person played, and has looked at the scene."""


BY_HAND = frozenset({DemonstrationKind.HUMAN, DemonstrationKind.HUMAN_WITH_SCENE})
"""Kinds that a person played."""


class Source(StrictModel):
    """Where demonstrations come from: what they were played in, by which policy, and the seed of their starts."""

    format: Literal["vitac-demonstrations-1"] = "vitac-demonstrations-1"
    manifest: Manifest
    stream: NonNegativeInt
    """Episode n starts with `rng_seed = (stream, n)`."""
    policy: Word | None = None
    """Digest of the submission whose policy played; None where the expert or a person did."""

    @property
    def task(self) -> Task:
        """Return the task as this installation has it."""
        return find_task(self.manifest.task)[1]


class Demonstration(StrictModel):
    """An episode that somebody played. `state_hashes` has one after the reset and one after each env step."""

    episode: PositiveInt
    kind: DemonstrationKind
    shape: Word
    outcome: EpisodeOutcome
    total_reward: float
    actions: ActionSequence
    state_hashes: tuple[StateHash, ...] = Field(min_length=1)

    @property
    def is_success(self) -> bool:
        """Whether the task was solved."""
        return self.outcome is EpisodeOutcome.SUCCESS

    def options(self, source: Source) -> Mapping[str, object]:
        """Return the options of `reset` with which it starts."""
        return {"rng_seed": (source.stream, self.episode)}


def make_line(content: Source | Demonstration) -> bytes:
    """Return the one line of some content."""
    return canonical_json(content.model_dump(mode="json")) + b"\n"


def read_source(path: Path) -> Source:
    """Return where the demonstrations of a file come from.

    Raises:
        CollectionRejected: it is no such file.
    """
    try:
        with path.open("rb") as file:
            return Source.model_validate_json(file.readline())
    except (OSError, ValidationError) as error:
        raise CollectionRejected(
            f"{path}:1 is not the first line of a file of demonstrations; make one with `vitac data collect`."
        ) from error


def read_demonstrations(path: Path) -> Iterator[Demonstration]:
    """Yield the demonstrations of a file, one at a time.

    Raises:
        CollectionRejected: a line is not what was written.
    """
    with path.open("rb") as file:
        file.readline()
        last = 0
        for number, line in enumerate(file, start=2):
            try:
                demonstration = Demonstration.model_validate_json(line)
            except ValidationError as error:
                raise CollectionRejected(
                    f"{path}:{number} is no demonstration ({error.errors()[0]['msg']}); collect again into "
                    "another folder."
                ) from error
            if demonstration.episode <= last:
                raise CollectionRejected(
                    f"{path}:{number} is episode {demonstration.episode}, expected one after {last}; collect again "
                    "into another folder."
                )
            last = demonstration.episode
            yield demonstration


_KINDS = (
    *(DemonstrationKind.CLEAN, DemonstrationKind.NOISY) * 4,
    *(DemonstrationKind.CLEAN, DemonstrationKind.MISLED),
)
"""Kinds of ten episodes, one after the other."""
_SPREAD = (0.05, 0.3)
"""Range from which the standard deviation of the noise of an episode is drawn."""
_POLICY_SPREAD = (0.0, 0.2)
"""The same where a policy plays."""
_BIAS = (0.6, 1.6)
"""Range from which the size of every number of a bias is drawn, at either sign."""


def list_tasks() -> list[str]:
    """Return the names of the tasks that policies play and an expert can; those of Track 3 need a sensor."""
    tracks = [load_track(name) for name in list_tracks()]
    return [
        task.name
        for track in tracks
        if not track.has_sensor
        for task in track.tasks.values()
        if task.definition.guided_motion is not None
    ]


def count_outcomes(path: Path) -> list[dict[str, Any]]:
    """Return the numbers of episodes, successes and env steps of every kind of demonstration in a file."""
    rows: dict[DemonstrationKind, dict[str, Any]] = {
        kind: {"kind": kind.value, "episodes": 0, "successes": 0, "env_steps": 0} for kind in DemonstrationKind
    }
    for each in read_demonstrations(path):
        counted = {"episodes": 1, "successes": each.is_success, "env_steps": each.actions.shape[0]}
        rows[each.kind] |= {name: rows[each.kind][name] + number for name, number in counted.items()}
    return [row for row in rows.values() if row["episodes"]]


def _report_nowhere(episodes: int, successes: int) -> None:
    """Stand in for a listener where there is none."""


def collect(
    task: str,
    folder: Path,
    *,
    successes: int,
    policy: Path | None = None,
    seed: int = 0,
    processes: int = 1,
    ray: str | None = None,
    report: Callable[[int, int], None] = _report_nowhere,
) -> Path:
    """Collect demonstrations until this many are successful, and return the file.

    What is in the file already is not played again. Every episode is handed to the system before the next one is
    awaited, so that a killed process loses none; all are on the disk when the collection ends.

    Args:
        task: name of a task, one with an expert if no policy plays.
        folder: the file is in a folder in it that is named after the task.
        successes: episode by episode until then.
        policy: zip or folder of a submission that plays in place of the expert.
        seed: of the starts.
        processes: that play.
        ray: address of a Ray cluster that plays instead.
        report: called with the numbers of episodes and of successes after each.

    Raises:
        NoExpert: the task has none.
        PolicyStopped: the policy failed.
        CollectionRejected: the file is of another seed or version.
        FolderInUse: another process writes there.
        NotSaved: it cannot be written.
    """
    track, definition = find_task(task)
    with ExitStack() as exits:
        player: Expert | PolicyPlayer
        if policy is None:
            player, digest = Expert(definition), None
        else:
            submission = exits.enter_context(staged(policy))
            player, digest = exits.enter_context(PolicyPlayer(track, definition, submission)), submission_digest(policy)
        manifest = make_manifest(track, definition, player.env)
        source = Source(manifest=manifest, stream=stream(seed, Use.COLLECT), policy=digest)
        path = folder / task / FILE
        file = exits.enter_context(open_collection(path, source))
        stored = list(read_demonstrations(path))
        n_episodes, n_successes = len(stored), sum(each.is_success for each in stored)
        if stored and stored[-1].episode != n_episodes:
            raise CollectionRejected(f"{path} leaves episodes out, expected all; collect into another folder.")
        report(n_episodes, n_successes)
        if n_successes >= successes:
            return path
        for played in map_in_order(partial(_play, player, source), count(n_episodes + 1), processes, ray=ray):
            file.write(make_line(played))
            file.flush()
            n_episodes, n_successes = n_episodes + 1, n_successes + played.is_success
            report(n_episodes, n_successes)
            if n_successes >= successes:
                break
        os.fsync(file.fileno())
    return path


@contextmanager
def open_collection(path: Path, source: Source) -> Iterator[BinaryIO]:
    """Hold the folder of a file of demonstrations, and open it to write after its last whole line.

    Raises:
        CollectionRejected: the file is of another source.
        FolderInUse: another process writes there.
        NotSaved: it cannot be written.
    """
    try:
        with hold_folder(path.parent), path.open("a+b") as file:
            _drop_partial_line(file)
            file.seek(0)
            first = file.readline()
            if not first:
                file.write(make_line(source))
                file.flush()
            elif first != make_line(source):
                raise CollectionRejected(
                    f"{path} was collected with another seed, policy or version, expected those of now; collect into "
                    "another folder."
                )
            yield file
    except OSError as error:
        raise not_saved(path, error) from error


def _drop_partial_line(file: BinaryIO) -> None:
    """Remove what a killed process left after the last line end."""
    file.seek(0)
    whole = 0
    for line in file:
        whole += len(line) if line.endswith(b"\n") else 0
    file.truncate(whole)


def _play(player: Expert | PolicyPlayer, source: Source, number: int) -> Demonstration:
    options, random = {"rng_seed": (source.stream, number)}, np.random.default_rng((source.stream, number, 1))
    if isinstance(player, PolicyPlayer):
        kind = (DemonstrationKind.POLICY, DemonstrationKind.NOISY_POLICY)[number % 2]
        spread = random.uniform(*_POLICY_SPREAD) if kind is DemonstrationKind.NOISY_POLICY else 0.0
        played = player.play(options, spread=spread, random=random)
    else:
        kind = _KINDS[(number - 1) % len(_KINDS)]
        played = player.play(options, _plans(kind, source, number, random))
    return Demonstration(
        episode=number,
        kind=kind,
        shape=str(player.env.task_scene.shape),
        outcome=EpisodeOutcome(played.info["end_reason"]),
        total_reward=played.total_reward,
        actions=ActionSequence.from_array(played.actions),
        state_hashes=played.state_hashes,
    )


def _plans(kind: DemonstrationKind, source: Source, number: int, random: np.random.Generator) -> tuple[ExpertPlan, ...]:
    """Return what the expert tries in an episode."""
    if kind is DemonstrationKind.CLEAN:
        return PLANS
    if kind is DemonstrationKind.NOISY:
        spread, noisy_steps = random.uniform(*_SPREAD), int(random.integers(1, 1 + source.task.max_steps // 4))
        return add_noise(PLANS, spread=spread, noisy_steps=noisy_steps, seed=(source.stream, number, 2))
    n_actions = len(source.task.actions)
    bias = random.choice((-1.0, 1.0), n_actions) * random.uniform(*_BIAS, n_actions)
    return (ExpertPlan(gain=1.0, measured=False, bias=tuple(bias.tolist())),)
