"""Which submissions exist for whom, who may change them, and what of them is shown.

Another team's is answered as if there were none.
"""

from uuid import UUID

from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.tracks import ListKind, load_track

from ..db.models import Submission
from ..errors import ProblemCode, ServiceError, not_found
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


def may_see_output(by: Principal, submission: Submission) -> bool:
    """Return whether what the submission's policy prints is shown to somebody.

    Only its team and the organizers see it. Of a sealed list only the organizers do, because a policy can print what it
    observes, and so tell its team the episodes. A log ran no policy here: the output that it names could be anything.
    """
    if not submission.kind.form.runs_policy or not by.may_see(submission.team_id):
        return False
    tasks = load_track(submission.track).tasks
    return by.is_organizer or all(tasks[task].episode_list.kind is ListKind.PUBLIC for task in submission.tasks)


def may_see_episode(by: Principal, submission: Submission, task: str) -> bool:
    """Return whether episodes of a task of a submission are shown to somebody who sees the submission.

    Those of a sealed list only to organizers: a playback shows where an episode starts.
    """
    return by.is_organizer or load_track(submission.track).tasks[task].episode_list.kind is ListKind.PUBLIC


def changeable(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Return the submission of that id for somebody who changes it: its team or an organizer.

    Raises:
        ServiceError: there is none that the principal may see, or it may only be read.
    """
    submission = visible(session, by, submission_id)
    if not by.may_change(submission.team_id):
        raise ServiceError(ProblemCode.FORBIDDEN, "A judge reads submissions only; ask an organizer.")
    return submission
