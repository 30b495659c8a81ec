"""Which stored episodes are those of an evaluation: one condition for all queries that ask."""

from sqlalchemy import and_, func

from .models import EpisodeResult, Evaluation, Submission

_OF_RUN = and_(
    EpisodeResult.submission_digest == Submission.digest,
    EpisodeResult.evaluator_version == Evaluation.evaluator_version,
    EpisodeResult.track == Submission.track,
    EpisodeResult.run == Evaluation.run,
)
_RANKED_LIST = func.coalesce(Evaluation.commitment, "")

OF_EVALUATION = and_(_OF_RUN, EpisodeResult.commitment == _RANKED_LIST)
"""Whether an evaluation's result is made of a stored episode, in a query on both and the submission."""

_LISTS = (_RANKED_LIST, func.coalesce(Evaluation.fresh_commitment, ""), "")
ON_ANY_LIST = and_(_OF_RUN, EpisodeResult.commitment.in_(_LISTS))
"""The same with the episodes on the public list and on a fresh one, which are played beside a sealed one."""
