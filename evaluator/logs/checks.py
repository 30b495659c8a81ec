"""Checks of a log that need no simulation; called by the verification and by the server at an upload."""

from collections.abc import Collection, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..episodes.records import EpisodeRecord, Manifest, PolicyFailure
from ..scoring.score import breaking_failure
from ..tracks import Task, Track
from ..tracks.definition import cut
from ..tracks.registry import differing_parts, find_version, list_parts
from .findings import Impossibility, ImpossibleReason
from .log import LogHeader
from .recordings import RecordingRejected, make_recording

_KEYS_THAT_MUST_AGREE = (
    "track",
    "task",
    "list_seed",
    "task_hash",
    "evaluator_version",
    "solver_version",
    "mesh_hash",
)


def known_without_running(track: Track, task: Task) -> dict[str, object]:
    """Return the manifest values of an evaluation by this evaluator that are known without making an environment."""
    return {
        "track": track.name,
        "task": task.name,
        "list_seed": task.episode_list.list_seed,
        "task_hash": task.digest(),
        "evaluator_version": find_version(track.name),
        "evaluator_parts": list_parts(track.name),
    }


def must_agree(manifest: Manifest) -> dict[str, object]:
    """Return the manifest values that a log must share with an evaluation that has this manifest."""
    return manifest.model_dump(include={*_KEYS_THAT_MUST_AGREE, "evaluator_parts"})


def explain_impossible(
    expected: Mapping[str, object],
    task: Task,
    header: LogHeader,
    records: Iterable[EpisodeRecord],
    episodes: Collection[int] | None = None,
) -> Impossibility | None:
    """Return why no evaluation can have made the log; None if one can.

    Args:
        expected: values that the header's manifest must have.
        task: task that the log must be of.
        header: header of the log.
        records: episodes of the log; read one at a time, none stays in memory.
        episodes: numbers of the required episodes; the whole list by default.
    """
    for key in _KEYS_THAT_MUST_AGREE:
        got = getattr(header.manifest, key)
        if got != expected.get(key, got):
            parts = _describe_difference(expected, header.manifest) if key == "evaluator_version" else ""
            message = f"Expected a log made with {key} {expected[key]!r}, got {got!r}{parts}; evaluate again."
            return Impossibility(reason=ImpossibleReason.OTHER_EVALUATION, message=message)
    wanted = {episode.number for episode in task.episodes} if episodes is None else set(episodes)
    missing = set(wanted)
    failed: list[EpisodeRecord] = []
    for record in records:
        problem = explain_impossible_record(task, record)
        if problem:
            return problem
        missing.discard(record.episode)
        failed.extend([record] if record.failure else [])
    return _missing(missing, wanted) or _broken(task, failed)


def _describe_difference(expected: Mapping[str, object], got: Manifest) -> str:
    """Return which parts of two evaluators differ, for a message; nothing where a log names no parts or the same."""
    parts = expected.get("evaluator_parts")
    if not isinstance(parts, Mapping) or not got.evaluator_parts:
        return ""
    differing = ", ".join(differing_parts(parts, got.evaluator_parts))
    return f" (they differ in {differing})" if differing else ""


def explain_impossible_record(task: Task, record: EpisodeRecord) -> Impossibility | None:
    """Return why no evaluation of the task can have made a record; None if one can."""
    place = f"Episode {record.episode}"

    def impossible(reason: ImpossibleReason, message: str) -> Impossibility:
        return Impossibility(reason=reason, message=message, episode=record.episode)

    if record.task != task.name:
        message = f"{place} is of task {record.task!r}, expected {task.name!r}."
        return impossible(ImpossibleReason.OTHER_TASK, message)
    if record.episode > len(task.episodes):
        return impossible(ImpossibleReason.NOT_IN_LIST, f"{place} is not in the list of {len(task.episodes)} episodes.")
    listed = task.episodes[record.episode - 1]
    if (record.shape, record.initial_offset) != (listed.shape, listed.offset):
        expected, got = f"{listed.shape} at {listed.offset}", f"{record.shape} at {record.initial_offset}"
        return impossible(ImpossibleReason.OTHER_START, f"{place}: expected the start {expected}, got {got}.")
    if record.env_steps > task.max_steps:
        message = f"{place} has {record.env_steps} env steps, expected at most {task.max_steps}."
        return impossible(ImpossibleReason.TOO_MANY_STEPS, message)
    try:
        outside = out_of_bounds(task, make_recording(record, task).actions)
    except RecordingRejected as error:
        return impossible(ImpossibleReason.WRONG_ACTION, str(error))
    return impossible(ImpossibleReason.WRONG_ACTION, f"{place} {outside}") if outside else None


def out_of_bounds(task: Task, actions: NDArray[np.float32]) -> str | None:
    """Return the end of a sentence about the first action outside [-1, 1]; None if all are inside.

    Args:
        task: task of the actions.
        actions: shape [env steps, action size].
    """
    outside = np.argwhere(np.abs(actions) > 1)
    if not len(outside):
        return None
    step, component = outside[0]
    got = f"{task.actions[component].name} = {actions[step, component]:g}"
    return f"has the action {got} at env step {step + 1}, expected values in [-1, 1]."


def _missing(missing: Collection[int], wanted: Collection[int]) -> Impossibility | None:
    if not missing:
        return None
    first = min(missing)
    message = f"Expected {len(wanted)} episodes, got {len(wanted) - len(missing)}; the first missing one is {first}."
    return Impossibility(reason=ImpossibleReason.EPISODE_MISSING, message=message, episode=first)


def _broken(task: Task, failed: Collection[EpisodeRecord]) -> Impossibility | None:
    failure: PolicyFailure | None = breaking_failure(cut(task), failed)
    if failure is None:
        return None
    # Failures of other episodes may be equal, down to the message.
    episode = next(record.episode for record in failed if record.failure is failure)
    message = f"The policy failed too often, starting at episode {episode}; such an evaluation ends without a score."
    return Impossibility(reason=ImpossibleReason.BROKEN_POLICY, message=message, episode=episode)
