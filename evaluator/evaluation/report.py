"""An evaluation as one JSON document, for `vitac evaluate --json`."""

from importlib.metadata import distributions
from typing import Self

from pydantic import Field

from ..agent.session import Isolation
from ..episodes.records import EpisodeRecord, Manifest, PolicyFailure
from ..scoring.score import Score
from ..strict_model import StrictModel
from .local import Evaluation


class EvaluationReport(StrictModel):
    """Everything about an evaluation; either `score` and `result_hash` or `failure` is there.

    `packages` are the versions by name of all that the policy could import here, such as torch; no hash covers them.
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
            packages=_packages(),
            episodes=evaluation.records,
        )


def _packages() -> dict[str, str]:
    """Return the versions of this Python's packages by name, ours left out; the sandbox has the same."""
    found = {(each.metadata["Name"] or "").lower(): each.version for each in distributions()}
    return {name: found[name] for name in sorted(found.keys() - {"", "vitac-arena"})}
