"""Which submissions no longer have an upload; asked by quotas, housekeeping and whoever starts an evaluation."""

from datetime import timedelta

from sqlalchemy import exists, func, or_

from .models import Evaluation, Submission
from .states import EvaluationState

CANCELLED_KEPT = timedelta(days=1)
"""How long the upload of a submission is stored all of whose evaluations were cancelled; it may be sent again."""

_OTHERS = or_(Evaluation.state != EvaluationState.CANCELLED, Evaluation.finished_at > func.now() - CANCELLED_KEPT)
_WAS_CANCELLED = exists().where(Evaluation.submission_id == Submission.id).correlate(Submission) & ~exists().where(
    Evaluation.submission_id == Submission.id, _OTHERS
).correlate(Submission)
HAS_NO_UPLOAD = _WAS_CANCELLED | Submission.erased_at.is_not(None)
"""Condition on submissions: their team deleted them, or all their evaluations were cancelled a day ago or earlier."""
