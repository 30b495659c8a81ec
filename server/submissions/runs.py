"""Runs of a submission's evaluation: which one comes next, cancelled, asked for again."""

from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks.registry import find_version

from ..audit import record
from ..database.locks import lock_evaluation
from ..database.models import Evaluation, Submission
from ..database.states import ACTIVE_EVALUATION_STATES, TERMINAL_EVALUATION_STATES, EvaluationState
from ..database.stored_uploads import HAS_NO_UPLOAD
from ..errors import ProblemCode, ServiceError
from ..evaluations import lifecycle
from ..evaluations.history import all_runs, newest_evaluation
from ..evaluations.verdicts import REFUTING_RESULTS, ServiceVerdict
from ..principals import Principal
from ..visibility import changeable, visible

MACHINE_FAILURES = 3
"""Evaluations of a submission that machines may end in 24 hours; after that only organizers start another."""


def cancel(session: Session, by: Principal, submission_id: UUID) -> None:
    """End the evaluation of a submission; its workers stop within seconds.

    Raises:
        ServiceError: there is no such submission, or its evaluation has ended.
    """
    submission = changeable(session, by, submission_id)
    _cancel(session, by, newest_evaluation(session, submission).id)


def cancel_evaluation(session: Session, by: Principal, evaluation: Evaluation) -> None:
    """End an evaluation: the one that its submission shows, or one that a rejudgement only proposes.

    Raises:
        ServiceError: it has ended, or who asks may not change it.
    """
    if evaluation.is_proposed:
        by.require_organizer(evaluation.submission.competition)
        _cancel(session, by, evaluation.id)
        return
    if newest_evaluation(session, evaluation.submission).id != evaluation.id:
        raise ServiceError(
            ProblemCode.NOT_CANCELLABLE, f"Evaluation {evaluation.id} has ended; a newer run of its submission exists."
        )
    cancel(session, by, evaluation.submission_id)


def run_again(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Start a new run of all episodes; the earlier results stay.

    Raises:
        ServiceError: not an organizer, no such submission, or its evaluation is still active.
    """
    by.require_organizer(by.competition)
    submission = visible(session, by, submission_id)
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    if submission.team.erased_at is not None:
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE, f"The upload of submission {submission.id} was removed with its team."
        )
    if session.scalar(select(HAS_NO_UPLOAD).where(Submission.id == submission.id)):
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE,
            f"The upload of submission {submission.id} was removed by its team, or a day after its evaluation was "
            "cancelled; its team may send it again.",
        )
    run = next_run(session, submission, again=True)
    if run is None:
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE,
            f"Submission {submission.id} is being evaluated{_name_rejudgement(session, submission)}; wait, or cancel "
            "that first.",
        )
    lifecycle.start(session, submission, run)
    record(session, by, "submission.requeue", f"submission:{submission.id}", {"run": run})
    return submission


def require_machines_hold(session: Session, by: Principal, submission: Submission) -> None:
    """Refuse another evaluation of a submission that machines have failed at again and again, but to organizers.

    Raises:
        ServiceError: not_requeuable.
    """
    failures = lifecycle.count_machine_failures(session, Submission.id == submission.id)
    if failures >= MACHINE_FAILURES and not by.organizes_service:
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE,
            f"The machines failed in {failures} evaluations of submission {submission.id} within 24 hours. Ask the "
            "organizers: they can find out why, and start it again.",
        )


def next_run(session: Session, submission: Submission, *, again: bool) -> int | None:
    """Return the number of the run to start, or None when the existing evaluation answers the request.

    A score answers it, and so does what was found against a log: its actions would lead to the same states again.
    """
    current = find_version(submission.track)
    runs = session.scalars(all_runs(submission)).all()
    if any(evaluation.state in ACTIVE_EVALUATION_STATES for evaluation in runs):
        return None
    same_version = [evaluation for evaluation in runs if evaluation.evaluator_version == current]
    if not same_version:
        return 1
    newest = next((evaluation for evaluation in same_version if not evaluation.is_proposed), None)
    if newest is None:
        return 1 + max(evaluation.run for evaluation in same_version)
    if not again and (newest.state is EvaluationState.COMPLETED or newest.verdict_code in REFUTING_RESULTS):
        return None
    if not again and _can_continue(newest):
        return newest.run
    return 1 + max(evaluation.run for evaluation in same_version)


def _cancel(session: Session, by: Principal, evaluation_id: UUID) -> None:
    evaluation = lock_evaluation(session, evaluation_id)
    submission_id = evaluation.submission_id
    if evaluation.state in TERMINAL_EVALUATION_STATES:
        raise ServiceError(
            ProblemCode.NOT_CANCELLABLE,
            f"The evaluation of submission {submission_id} is {evaluation.state} already; there is nothing to cancel.",
            state=evaluation.state.value,
        )
    lifecycle.cancel(session, evaluation)
    record(session, by, "submission.cancel", f"submission:{submission_id}", {"evaluation": str(evaluation.id)})


def _name_rejudgement(session: Session, submission: Submission) -> str:
    """Return which evaluation of a rejudgement is active, for a message; empty where none is."""
    proposed = all_runs(submission).where(Evaluation.is_proposed, Evaluation.state.in_(ACTIVE_EVALUATION_STATES))
    proposal = session.scalars(proposed.limit(1)).first()
    return f" for rejudgement {proposal.rejudgement_id} (evaluation {proposal.id})" if proposal else ""


def _can_continue(evaluation: Evaluation) -> bool:
    by_machines = evaluation.verdict_code == ServiceVerdict.MACHINE_FAILED
    return evaluation.state is EvaluationState.CANCELLED or by_machines
