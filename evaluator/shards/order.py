"""The protocol with the process of a shard: one order to it, a line for each message from it, and how its run ends."""

import struct
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from pydantic import NonNegativeInt, PositiveInt
from vitac.envs.maniskill.definition import is_maniskill
from vitac.errors import VitacError

from ..agent.limits import Limits
from ..agent.session import Isolation
from ..episodes.records import EpisodeRecord, Manifest, PolicyFailure
from ..figures.figures import FigureChoice, FiguresPart
from ..isolation_kinds import IsolationKind
from ..logs.findings import LogFinding
from ..regression import Coefficients
from ..strict_model import StrictModel
from ..submission_kinds import SubmissionKind
from ..tracks import Task, Track, load_track
from ..tracks.definition import ShardEpisodes


class ShardEnd(StrEnum):
    """Why the run of a shard ended."""

    COMPLETE = "complete"
    """All its episodes have a record."""
    BROKEN = "broken"
    """The policy cannot be loaded or failed too often; the rest was not played."""
    REFUTED = "refuted"
    """What was re-simulated is not true; the finding says why, and the rest was not re-simulated."""


class ShardResult(StrictModel):
    """What the run of a shard ended with; its records went to `on_episode` one by one."""

    index: int
    end: ShardEnd
    manifest: Manifest
    isolation: Isolation | None
    """How strongly the policy was isolated; None if it was not started or did not load."""
    finding: LogFinding | None = None
    """Why a log is not true; None for models and as long as the log holds."""
    coefficients: Coefficients | None = None
    """Coefficients of the standard estimator; None if it did not play."""
    figures: FiguresPart | None = None
    """This shard's part of the figures of a sensor; None where they were not asked for."""


PROCESS_ID: Final = struct.Struct("<q")
"""How the process of a shard introduces itself before its first message; its pidfd comes along."""

OnCalibration = Callable[[int, int], None]
"""Gets how many starts of a sensor's calibration are played, and of how many."""

_CALIBRATION: Final = struct.Struct("<ii")


def encode_waiting(played: int, starts: int) -> bytes:
    """Return the host's word, instead of an introduction, that it forks the process after a sensor's calibration.

    Args:
        played: starts of the calibration that are played; 0 before the first.
        starts: all of them.
    """
    return _CALIBRATION.pack(played, starts)


def decode_waiting(word: bytes) -> tuple[int, int]:
    """Return how many starts of the calibration are played, and of how many."""
    played, starts = _CALIBRATION.unpack(word)
    return played, starts


_OF_ONE_SHARD: Final = frozenset(
    {"secret", "shard", "episodes", "skip", "earlier_failures", "coefficients", "code", "attempt"}
)
"""Which episodes are played, and from where they are taken; environment and policy are the same for all lists."""


class AttemptSpent(VitacError):
    """Ended work in a way that costs it an attempt where faults of machines cost none; the message says how."""


class ShardOrder(StrictModel):
    """What a shard's process has to do.

    `submission` is the folder of an unpacked archive, or the file of a log; `secret` the file with the secret of a
    sealed list, without which the public one is played; `sensor` a folder with a sensor of a team's own, or the
    file of a made one. `figures` says of which of the sensor's figures the shard measures a part. `coefficients`
    are what the standard estimator has learned of the sensor; without them it is calibrated first. `episode_period_s`
    is the time from the start of an episode to that of the next [s], and `isolation` what stands between policy and
    machine; without them what the machine is set to. `remote` is the address of a policy server that plays in place of
    the submission's own code. A process of another `evaluator_version` than the given one refuses the order. `code` is
    the one-time code of a trial on a station, and `attempt` counts those that were not free.
    """

    kind: SubmissionKind
    submission: Path
    track: str
    task: str
    evaluator_version: str | None = None
    secret: Path | None = None
    shard: NonNegativeInt
    episodes: tuple[int, ...] | None = None
    limits: Limits = Limits()
    assets_dir: Path | None = None
    sensor: Path | None = None
    figures: FigureChoice = FigureChoice.NONE
    coefficients: Coefficients | None = None
    episode_period_s: float | None = None
    isolation: IsolationKind | None = None
    remote: str | None = None
    code: str | None = None
    attempt: PositiveInt = 1
    skip: tuple[int, ...] = ()
    earlier_failures: tuple[PolicyFailure, ...] = ()

    def preparation(self) -> dict[str, object]:
        """Return what environment and loaded policy depend on; orders that have it in common can share them.

        Shards of ManiSkill share nothing: what its environments may leave in memory ends with their process.
        """
        return self.model_dump(exclude=set() if self._is_of_maniskill() else set(_OF_ONE_SHARD))

    def _is_of_maniskill(self) -> bool:
        with suppress(VitacError, KeyError):  # whoever carries the order out says what there is not
            return is_maniskill(load_track(self.track).tasks[self.task].env_id)
        return False


@dataclass(frozen=True, kw_only=True)
class OrderedShard:
    """An order with what it names."""

    order: ShardOrder
    track: Track
    task: Task
    shard: ShardEpisodes

    @property
    def numbers(self) -> frozenset[int]:
        """Episodes that have no record yet."""
        return self.shard.numbers - set(self.order.skip)


class ShardMessage(StrictModel):
    """One line from a shard's process: exactly one of its fields."""

    packages: dict[str, str] | None = None
    """Versions of the packages that the policy sees, by name; the first message of a shard that runs a policy."""
    record: EpisodeRecord | None = None
    result: ShardResult | None = None
    error: str | None = None
