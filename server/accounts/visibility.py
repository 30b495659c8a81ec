"""Which submissions exist for whom: another team's is answered as if there were none."""

from uuid import UUID

from sqlalchemy.orm import Session, joinedload

from ..db.models import Submission
from ..errors import not_found
from .principals import Principal


def visible(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Return the submission of that id.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    submission = session.get(Submission, submission_id, options=[joinedload(Submission.team)])
    if submission is None or not by.may_see(submission.team_id):
        raise not_found("submission", submission_id)
    return submission
