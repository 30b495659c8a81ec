"""What a shard's process is told and what it tells: one order to it, one message for each line from it."""

import struct
from pathlib import Path
from typing import Final, Self

from pydantic import NonNegativeInt, model_validator

from ..agent.limits import Limits
from ..episodes.records import EpisodeRecord, PolicyFailure
from ..strict_model import StrictModel
from .result import ShardResult

PROCESS_ID: Final = struct.Struct("<q")
"""How the process of a shard introduces itself before its first message; its pidfd comes along."""


class ShardOrder(StrictModel):
    """What a shard's process has to do: play a submission, or re-simulate an uploaded log."""

    submission_dir: Path | None = None
    log: Path | None = None
    text_log: Path | None = None
    track: str
    task: str
    shard: NonNegativeInt
    episodes: tuple[int, ...] | None = None
    slot: NonNegativeInt = 0
    limits: Limits = Limits()
    assets_dir: Path | None = None
    skip: tuple[int, ...] = ()
    earlier_failures: tuple[PolicyFailure, ...] = ()

    @model_validator(mode="after")
    def _names_one_source(self) -> Self:
        if sum(source is not None for source in (self.submission_dir, self.log, self.text_log)) != 1:
            raise ValueError("exactly one of submission_dir, log and text_log must be given")
        return self


class ShardMessage(StrictModel):
    """One line from a shard's process: exactly one of its fields."""

    record: EpisodeRecord | None = None
    result: ShardResult | None = None
    error: str | None = None
