"""Which stored episodes are those of an evaluation: one condition for all queries that ask."""

from sqlalchemy import and_, func

from .models import EpisodeResult, Evaluation, Submission

OF_EVALUATION = and_(
    EpisodeResult.submission_digest == Submission.digest,
    EpisodeResult.evaluator_version == Evaluation.evaluator_version,
    EpisodeResult.track == Submission.track,
    EpisodeResult.run == Evaluation.run,
    EpisodeResult.commitment == func.coalesce(Evaluation.commitment, ""),
)
"""Whether a stored episode is one of an evaluation's, in a query on both and the submission."""
