"""Records of episodes: what they hold, their hashes, where they come from, and how files of them are read."""

import base64
import binascii
import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    Field,
    JsonValue,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from vitac.envs.observable import Observable
from vitac.envs.tasks.definition import chosen_observables
from vitac.errors import VitacError

from ..agent.protocol import CloudSpec
from ..agent.verdicts import VerdictCode
from ..sentence_enum import SentenceEnum
from ..strict_model import StrictModel, Word
from ..tracks import Task, Track
from ..tracks.registry import compute_hash, find_version, list_parts
from ..version import platform_class

NOT_HASHED: Final = frozenset({"timings", "output"})
"""Fields of a record that may differ when its episode is played again; never part of a digest or of a log."""
_OMITTED: Final = frozenset({"picture", "forces", "evidence"})
"""Fields that the JSON of a record has only where there is a value."""
StateHash = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
TwinWords = Annotated[str, Field(pattern=r"^[\w.+:, -]+$", max_length=1000)]
"""What kind of twin a station is (`station.description.TwinMark`); plain words, as `Word` is."""


class RecordsDisagree(VitacError):
    """The records given are not those of one evaluation: an episode occurs twice, or is of another task."""


class EpisodeOutcome(SentenceEnum):
    """How an episode ended."""

    SUCCESS = "success", "The task was solved."
    FORCE = "force", "The force on the held part was above the task's limit."
    TACTILE = "tactile", "The gel surface of a sensor moved too far."
    ERROR = "error", "The gripper or the part left its range."
    STEPS = "steps", "All env steps were used up."
    NOT_CONVERGED = "not_converged", "The physics found no solution for an IPC step, even in smaller pieces."
    POLICY_FAILED = "policy_failed", "The policy crashed, broke a limit or answered wrongly."
    ACTIONS_ENDED = "actions_ended", "The recorded actions of a 2025 text log ended before the episode did."


def counted_env_steps(number: int) -> str:
    """Return a number of env steps with its unit, as people say it: "1 env step", "5 env steps"."""
    return "1 env step" if number == 1 else f"{number} env steps"


class ActionSequence(StrictModel):
    """The raw actions of an episode as the policy gave them: float32, little-endian, row-major, base64 in JSON."""

    shape: tuple[Annotated[int, Field(ge=0, le=1_000_000)], Annotated[int, Field(ge=1, le=64)]]
    float32_base64: str

    @classmethod
    def from_array(cls, actions: NDArray[np.float32]) -> Self:
        """Pack actions, shape [env steps, action size]."""
        data = base64.b64encode(np.ascontiguousarray(actions, dtype="<f4").tobytes()).decode("ascii")
        return cls(shape=(actions.shape[0], actions.shape[1]), float32_base64=data)

    def to_array(self) -> NDArray[np.float32]:
        """Return the actions, shape [env steps, action size]."""
        return np.frombuffer(base64.b64decode(self.float32_base64), dtype="<f4").reshape(self.shape).astype(np.float32)

    @model_validator(mode="after")
    def _bytes_fit_shape(self) -> Self:
        try:
            data = base64.b64decode(self.float32_base64, validate=True)
        except binascii.Error as error:
            raise ValueError(f"actions are not base64: {error}") from error
        if len(data) != 4 * self.shape[0] * self.shape[1]:
            raise ValueError(f"actions hold {len(data)} bytes, expected 4 x {self.shape[0]} x {self.shape[1]}")
        if not np.isfinite(np.frombuffer(data, dtype="<f4")).all():
            raise ValueError("actions hold NaN or infinity; every action must be finite")
        return self


class FailureStage(StrEnum):
    """When a policy failed."""

    LOAD = "load"
    """While it was imported and built; it cannot play any episode."""
    EPISODE = "episode"
    """While it played an episode."""


class PolicyFailure(StrictModel):
    """Why a policy failed, and the last lines of its output (for its team only)."""

    stage: FailureStage
    code: VerdictCode
    message: str
    output_tail: str = ""

    @property
    def sentence(self) -> str:
        """What was said, and what to do about it, as sentences."""
        message = self.message.rstrip()
        return f"{message}{'' if message.endswith(('.', '!', '?', '.)')) else '.'} {self.code.explain(message)}"


class Timings(StrictModel):
    """Where an episode's time went [s]; never part of a hash."""

    physics_s: NonNegativeFloat = 0.0
    markers_s: NonNegativeFloat = 0.0
    policy_s: NonNegativeFloat = 0.0
    channel_s: NonNegativeFloat = 0.0
    answers_s: tuple[NonNegativeFloat, ...] = ()
    """Of a policy elsewhere: from each question to its answer."""
    wall_s: NonNegativeFloat = 0.0


class SampledPicture(StrictModel):
    """The pictures of one env step, which `picture_sample` selects; env step 0 is the reset."""

    env_step: NonNegativeInt
    sha256: StateHash
    """Hash over all pictures of the task at that env step, observed or not."""


class ForceFigures(StrictModel):
    """Size of a contact force over the solved IPC steps of all env steps of an episode, its reset left out.

    `p95_n` is the smallest of the forces that 95 % of the IPC steps do not exceed; `impulse_n_s` is the integral over
    simulated time.
    """

    peak_n: NonNegativeFloat
    p95_n: NonNegativeFloat
    impulse_n_s: NonNegativeFloat


class ContactForces(StrictModel):
    """Forces of an episode: on the held part, of all that does not hold it, and on the left and the right gel.

    `over_force_events` counts in how many runs of consecutive IPC steps the force on the part was above `over_force_n`:
    the task's limit, or `forces.OVER_FORCE_N` without one. The stretches stand for damage to the gels and include that
    of the grasp: the largest principal stretch of an element, and the largest over the IPC steps of what 95 % of the
    elements do not exceed. A station measures the force on the part alone, from the first contact on.
    """

    part: ForceFigures
    gels: tuple[ForceFigures, ForceFigures] | None = None
    over_force_n: PositiveFloat
    over_force_events: NonNegativeInt
    largest_stretch: NonNegativeFloat | None = None
    high_stretch: NonNegativeFloat | None = None


class TrialVideo(StrictModel):
    """The video of a trial (`station.video`): its one-time code, its frames, the last link of their chain, its file."""

    code: str = Field(pattern=r"^[0-9A-F]{8,64}$")
    frames: PositiveInt
    link: StateHash
    sha256: StateHash
    n_bytes: PositiveInt


class HelpKind(StrEnum):
    """What a person did in a trial."""

    REGRASP = "regrasp"
    """Had the part grasped again before the policy began."""
    PAUSE = "pause"
    RELEASE = "release"
    """Made the station safe after a stop before the trial."""
    NOTE = "note"


class HumanHelp(StrictModel):
    """A person's help in a trial, or before it since the trial before.

    Attributes:
        at_s: when it began, from the start of the trial [s]; negative before it.
        length_s: how long it took [s].
        note: what the person wrote.
    """

    kind: HelpKind
    at_s: float
    length_s: NonNegativeFloat
    note: str = Field(default="", max_length=500)


class TrialEvidence(StrictModel):
    """What a station recorded of a trial besides what its policy did.

    Attributes:
        station: by its name.
        twin: what kind of twin played it in place of a station's devices, in words; None for hardware.
        video: None where the station's trials have none.
        help: of people.
    """

    station: Word
    twin: TwinWords | None = None
    video: TrialVideo | None = None
    help: tuple[HumanHelp, ...] = ()


class EpisodeRecord(StrictModel):
    """One finished episode.

    `state_hashes` has one entry after the reset and one after each env step; `infos` one entry per env step.
    `initial_offset` is in the units of the task's `offset_option` (mm and degrees). `output` is the end of what the
    policy printed meanwhile, for its team only. `picture` is of a task with cameras only, `forces` of one whose physics
    reports them and of an episode with an env step, `evidence` of a trial; the record of another one does not have the
    key.
    """

    episode: PositiveInt
    task: Word
    shape: Word
    initial_offset: tuple[float, ...]
    outcome: EpisodeOutcome
    env_steps: NonNegativeInt
    total_reward: float
    actions: ActionSequence
    state_hashes: tuple[StateHash, ...] = Field(min_length=1)
    infos: tuple[dict[str, JsonValue], ...]
    picture: SampledPicture | None = None
    forces: ContactForces | None = None
    evidence: TrialEvidence | None = None
    failure: PolicyFailure | None = None
    timings: Timings = Timings()
    output: str = ""

    @property
    def success(self) -> bool:
        """Whether the task was solved."""
        return self.outcome is EpisodeOutcome.SUCCESS

    @property
    def video(self) -> TrialVideo | None:
        """That of a trial on a station."""
        return self.evidence.video if self.evidence else None

    @model_validator(mode="after")
    def _lengths_agree(self) -> Self:
        lengths = (self.actions.shape[0], len(self.state_hashes) - 1, len(self.infos))
        if any(length != self.env_steps for length in lengths):
            raise ValueError(
                f"env_steps is {self.env_steps}, but there are {lengths[0]} actions, {lengths[1]} state hashes "
                f"after the reset's and {lengths[2]} infos; all four must agree"
            )
        if (self.failure is not None) != (self.outcome is EpisodeOutcome.POLICY_FAILED):
            raise ValueError(f"outcome {self.outcome.value} and failure {self.failure} do not belong together")
        if self.picture is not None and self.picture.env_step > self.env_steps:
            raise ValueError(f"picture is of env step {self.picture.env_step}, expected at most {self.env_steps}")
        return self

    @model_serializer(mode="wrap")
    def _drop_absent(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written: dict[str, Any] = write(self)
        return {key: value for key, value in written.items() if key not in _OMITTED or value is not None}

    def record_digest(self) -> str:
        """Return the SHA-256 [hex] of all but `NOT_HASHED`; equal records of a repeated episode have equal digests."""
        return digest_of_stored(self.model_dump(mode="json"))


def digest_of_stored(record: Mapping[str, Any]) -> str:
    """Return the `record_digest` of a record that was written as JSON values, with or without its `NOT_HASHED`."""
    hashed = {name: value for name, value in record.items() if name not in NOT_HASHED}
    return hashlib.sha256(canonical_json(hashed)).hexdigest()


class Manifest(StrictModel):
    """What an evaluation was made with. `evaluator_parts` show in what evaluators differ."""

    track: Word
    task: Word
    list_seed: NonNegativeInt
    task_hash: Word
    evaluator_version: Word
    evaluator_hash: Word
    evaluator_parts: dict[Word, Word] = Field(default={}, max_length=16)
    solver_version: Word
    mesh_hash: Word
    platform_class: Word


_HASHED_MANIFEST_KEYS = {"track", "task", "list_seed", "evaluator_version", "solver_version", "mesh_hash"}


def result_hash(manifest: Manifest, records: Iterable[EpisodeRecord]) -> str:
    """Return the SHA-256 [hex] of an evaluation: what it was made with, and its actions, states, pictures and outcomes.

    It depends neither on the order of the records nor on times, so one and many workers, the command line and the
    server, and a resumed evaluation agree. It is the hash of JSON lines (sorted keys, no blanks): first the manifest,
    then each record.

    Raises:
        RecordsDisagree: an episode occurs twice, or a record is of another task.
    """
    digest = hashlib.sha256()
    digest.update(canonical_json(manifest.model_dump(mode="json", include=_HASHED_MANIFEST_KEYS)) + b"\n")
    for record in sort_records(manifest.task, records):
        digest.update(canonical_json(_hashed_part(record)) + b"\n")
    return digest.hexdigest()


def sort_records(task: str, records: Iterable[EpisodeRecord]) -> list[EpisodeRecord]:
    """Return the records sorted by episode number.

    Raises:
        RecordsDisagree: an episode occurs twice, or a record is of another task.
    """
    by_number: dict[int, EpisodeRecord] = {}
    for record in records:
        if record.task != task:
            raise RecordsDisagree(f"Episode {record.episode} is of task {record.task!r}, expected {task!r}.")
        if record.episode in by_number:
            raise RecordsDisagree(f"Expected each episode once, got episode {record.episode} twice.")
        by_number[record.episode] = record
    return [by_number[number] for number in sorted(by_number)]


def canonical_json(content: Mapping[str, Any]) -> bytes:
    """Return the one JSON text of some content: sorted keys, no blanks, ASCII, no NaN."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")


def _hashed_part(record: EpisodeRecord) -> dict[str, Any]:
    pictures = {"picture": record.picture.model_dump(mode="json")} if record.picture else {}
    evidence = {"evidence": record.evidence.model_dump(mode="json")} if record.evidence else {}
    return (
        pictures
        | evidence
        | {
            "episode": record.episode,
            "actions": record.actions.model_dump(mode="json"),
            "state_hashes": list(record.state_hashes),
            "outcome": record.outcome.value,
            "failure": record.failure.code.value if record.failure else None,
        }
    )


class SimulationVersions(Protocol):
    """What episodes are played with."""

    @property
    def solver_version(self) -> str:
        """Version of what moves the parts."""

    def mesh_hash(self) -> str:
        """Return the SHA-256 [hex] of the meshes and settings."""


def make_manifest(track: Track, task: Task, env: SimulationVersions) -> Manifest:
    """Return what an evaluation in this environment, or on a station, is made with."""
    return Manifest(
        track=track.name,
        task=task.name,
        list_seed=task.episode_list.list_seed,
        task_hash=task.digest(),
        evaluator_version=find_version(track.name),
        evaluator_hash=compute_hash(track.name),
        evaluator_parts=dict(list_parts(track.name)),
        solver_version=env.solver_version,
        mesh_hash=env.mesh_hash(),
        platform_class=platform_class(),
    )


Observation = Mapping[str, NDArray[Any]]


class Observed(Protocol):
    """What says which observables a policy may read: a task of a track."""

    @property
    def observables(self) -> tuple[Observable[Any], ...]:
        """Nothing privileged is among them."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """The part of an observation that reaches a policy.

    A point cloud follows from its depth picture, so the picture is sent and the policy's side makes the cloud of it.

    Attributes:
        keys: what the policy reads, in the order of the task.
        sent: what the environment computes and what is sent.
        clouds: what the policy's side makes of what was sent.
    """

    keys: tuple[str, ...]
    sent: tuple[str, ...]
    clouds: tuple[CloudSpec, ...]


def make_reading(task: Observed, keys: Collection[str] | None = None) -> Reading:
    """Return what a policy reads that names these keys; keys that are another task's are left out.

    Args:
        task: what is played.
        keys: from the submission manifest; None for all of the task's.
    """
    listed = task.observables
    read = listed if keys is None else tuple(entry for entry in listed if entry.name in keys)
    names = {entry.name for entry in read}
    clouds = [
        CloudSpec(
            name=entry.name,
            depth=entry.computed_from.depth,
            keep_depth=entry.computed_from.depth in names,
            intrinsics=list(entry.computed_from.intrinsics),
        )
        for entry in read
        if entry.computed_from
    ]
    sent = {entry.name for entry in read if not entry.computed_from} | {cloud.depth for cloud in clouds}
    return Reading(
        keys=tuple(entry.name for entry in read),
        sent=tuple(entry.name for entry in chosen_observables(listed, sent)),
        clouds=tuple(clouds),
    )
