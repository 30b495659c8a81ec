"""What an uploaded log says of itself: stored with its submission, shown beside the result of its re-simulation."""

from collections.abc import Collection
from typing import Any, Self

from pydantic import NonNegativeFloat, NonNegativeInt
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest, result_hash
from vitac.evaluator.logs.log import LogHeader
from vitac.evaluator.logs.text_2025 import TextLogSummary
from vitac.evaluator.scoring.score import score
from vitac.evaluator.strict_model import StrictModel


class LogClaim(StrictModel):
    """The claims of a log.

    `submission_digest`, `manifest` and `result_hash` are those of our own logs; `problems` are the sentences about a
    2025 text log whose numbers do not follow from each other.
    """

    team: str | None
    episodes: NonNegativeInt
    successes: NonNegativeInt
    success_rate: NonNegativeFloat
    mean_steps: NonNegativeFloat | None
    submission_digest: str | None = None
    manifest: Manifest | None = None
    result_hash: str | None = None
    problems: tuple[str, ...] = ()

    @classmethod
    def from_log(cls, header: LogHeader, records: Collection[EpisodeRecord]) -> Self:
        """Return what one of our logs claims."""
        claimed = score(records)
        return cls(
            team=header.team,
            episodes=claimed.episodes,
            successes=claimed.successes,
            success_rate=claimed.success_rate,
            mean_steps=claimed.mean_steps,
            submission_digest=header.submission_digest,
            manifest=header.manifest,
            result_hash=result_hash(header.manifest, records),
        )

    @classmethod
    def from_text_log(cls, summary: TextLogSummary, problems: tuple[str, ...]) -> Self:
        """Return what a text log claims in its last lines."""
        return cls(
            team=summary.team,
            episodes=summary.episodes,
            successes=summary.successes,
            success_rate=summary.claimed_success_rate or 0.0,
            mean_steps=summary.claimed_average_steps,
            problems=problems,
        )

    def stored(self) -> dict[str, Any]:
        """Return the claims as the submission's `manifest` column holds them."""
        return self.model_dump(mode="json")
