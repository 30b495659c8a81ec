"""What the run of a shard ends with, whatever was run."""

from enum import StrEnum

from ..agent.session import Isolation
from ..episodes.records import Manifest
from ..estimator.regression import Coefficients
from ..figures.figures import FiguresPart
from ..logs.findings import LogFinding
from ..strict_model import StrictModel


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
