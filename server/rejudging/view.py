"""Makes the views of rejudgements; called by API and pages."""

from collections.abc import Sequence

from sqlalchemy.orm import Session

from ..db.models import Rejudgement
from ..views.rejudging import RejudgedSubmissionView, RejudgementDetailView, RejudgementView
from .comparison import comparison, compute_revision


def rejudgement_view(rejudgement: Rejudgement) -> RejudgementView:
    """Return a rejudgement without its submissions."""
    return RejudgementView(
        id=rejudgement.id,
        competition=rejudgement.competition or None,
        track=rejudgement.track,
        stage=rejudgement.stage or None,
        reason=rejudgement.reason,
        started_at=rejudgement.started_at,
        applied_at=rejudgement.applied_at,
        discarded_at=rejudgement.discarded_at,
    )


def rejudgement_detail_view(
    session: Session, rejudgement: Rejudgement, rows: Sequence[RejudgedSubmissionView] | None = None
) -> RejudgementDetailView:
    """Return a rejudgement with its submissions; `rows`: as they were compared before it was applied."""
    found = comparison(session, rejudgement) if rows is None else rows
    return RejudgementDetailView(
        **dict(rejudgement_view(rejudgement)),
        revision=compute_revision(found),
        submissions=list(found),
    )
