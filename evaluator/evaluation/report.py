"""An evaluation as one JSON document, for `vitac evaluate --json`."""

from typing import Self

from ..agent.session import Isolation
from ..episodes.records import EpisodeRecord, Manifest, PolicyFailure
from ..scoring.score import Score
from ..strict_model import StrictModel
from .local import Evaluation


class EvaluationReport(StrictModel):
    """Everything about an evaluation; either `score` and `result_hash` or `failure` is there."""

    name: str
    submission_digest: str
    manifest: Manifest
    isolation: Isolation | None
    score: Score | None
    result_hash: str | None
    failure: PolicyFailure | None
    episodes: tuple[EpisodeRecord, ...]

    @classmethod
    def of(cls, evaluation: Evaluation, *, name: str, digest: str) -> Self:
        """Return the report on an evaluation of the submission of that name and digest."""
        return cls(
            name=name,
            submission_digest=digest,
            manifest=evaluation.manifest,
            isolation=evaluation.isolation,
            score=evaluation.score,
            result_hash=evaluation.result_hash,
            failure=evaluation.failure,
            episodes=evaluation.records,
        )
