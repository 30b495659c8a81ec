"""Which submissions exist for whom, who may change them, and what of them is shown.

Another team's is answered as if there were none; `vitac.server.leaderboards.public_pages` knows which ones are public.
"""

from dataclasses import dataclass
from uuid import UUID

from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.tracks import ListKind

from .database.models import Evaluation, Submission
from .errors import ProblemCode, ServiceError, not_found
from .principals import Principal
from .tracks import known_task


def visible(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Return the submission of that id.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    submission = session.get(Submission, submission_id, options=[joinedload(Submission.team)])
    if submission is None or not by.may_see(submission.team_id, submission.competition):
        raise not_found("submission", submission_id)
    return submission


@dataclass(frozen=True, kw_only=True)
class EvaluationVisibility:
    """What of an evaluation is shown to somebody who may see its result; its state and score always are.

    Attributes:
        episodes: single episodes: outcomes, records, logs, playback, pictures, and how many succeeded before the end.
        output: what the policy printed.
        practice: single episodes on the public list, where it is played beside a sealed one.
    """

    episodes: bool
    output: bool
    practice: bool


def decide_sight(by: Principal, evaluation: Evaluation) -> EvaluationVisibility:
    """Return what of an evaluation is shown to somebody: all that shows single episodes asks here.

    While a list is sealed, only organizers see its episodes, and what was printed there, because a policy can print
    what it observes. A log ran no policy here: the output that it names could be anything.
    """
    submission = evaluation.submission
    is_own = by.may_see(submission.team_id, submission.competition)
    practice = by.organizes(submission.competition) or is_own or submission.is_public
    episodes = by.organizes(submission.competition) or (practice and not is_sealed(evaluation))
    output = episodes and is_own and submission.kind.form.runs_policy
    return EvaluationVisibility(episodes=episodes, output=output, practice=practice)


def is_sealed(evaluation: Evaluation) -> bool:
    """Return whether an evaluation plays a list whose secret is not published yet.

    A sealed list of a track file is published by taking its commitment out of the file, so today's file decides.
    """
    if evaluation.commitment is not None and evaluation.sealed_list is not None:
        return evaluation.sealed_list.revealed_at is None
    if played_list_kind(evaluation) is ListKind.PUBLIC:
        return False
    return evaluation.commitment is not None or find_list_kind(evaluation.submission) is ListKind.SEALED


def played_list_kind(evaluation: Evaluation) -> ListKind:
    """Return who could know the episodes while they were played: of a stage's sealed list, or of the track file's."""
    return ListKind.SEALED if evaluation.commitment is not None else evaluation.list_kind


def find_list_kind(submission: Submission) -> ListKind:
    """Return who may know the episodes by today's track file; a list that was removed counts as sealed."""
    tasks = [known_task(submission.track, task) for task in submission.tasks]
    kinds = {ListKind.SEALED if task is None else task.episode_list.kind for task in tasks}
    return ListKind.SEALED if ListKind.SEALED in kinds else ListKind.PUBLIC


def require_episodes(by: Principal, evaluation: Evaluation) -> None:
    """Refuse to show single episodes of a sealed list.

    Raises:
        ServiceError: list_sealed.
    """
    if not decide_sight(by, evaluation).episodes:
        raise ServiceError(
            ProblemCode.LIST_SEALED,
            "This evaluation plays a sealed list: until its secret is published, only its state and its final score "
            "are shown.",
        )


def changeable(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Return the submission of that id for somebody who changes it: its team or an organizer.

    Raises:
        ServiceError: there is none that the principal may see, or it may only be read.
    """
    submission = visible(session, by, submission_id)
    if not by.may_change(submission.team_id, submission.competition):
        raise ServiceError(ProblemCode.FORBIDDEN, "A judge reads submissions only; ask an organizer.")
    return submission
