"""An evaluation as one JSON document, for `vitac evaluate --json`."""

from typing import Self

from pydantic import Field

from ..agent.isolation.interpreter import installed_packages
from ..agent.session import Isolation
from ..episodes.records import EpisodeRecord, Manifest, PolicyFailure
from ..scoring.score import Score
from ..strict_model import StrictModel
from ..tracks import load_track
from .local import Evaluation


class EvaluationReport(StrictModel):
    """Everything about an evaluation; either `score` and `result_hash` or `failure` is there.

    `packages` are the versions by name of all that the policy could import here; no hash covers them.
    """

    name: str
    submission_digest: str
    manifest: Manifest
    isolation: Isolation | None
    score: Score | None
    result_hash: str | None
    failure: PolicyFailure | None
    packages: dict[str, str] = Field(default_factory=dict)
    episodes: tuple[EpisodeRecord, ...]

    @classmethod
    def from_evaluation(cls, evaluation: Evaluation, *, name: str, digest: str) -> Self:
        """Return the report on an evaluation of the submission of that name and digest."""
        return cls(
            name=name,
            submission_digest=digest,
            manifest=evaluation.manifest,
            isolation=evaluation.isolation,
            score=evaluation.score,
            result_hash=evaluation.result_hash,
            failure=evaluation.failure,
            packages=dict(installed_packages(load_track(evaluation.manifest.track).packages).versions),
            episodes=evaluation.records,
        )
