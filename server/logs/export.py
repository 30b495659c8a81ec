"""The log of a completed evaluation, as `vitac evaluate --log` writes it; called by the API."""

from io import BytesIO
from uuid import UUID

from sqlalchemy.orm import Session
from vitac.evaluator.logs.log import LogHeader, write_log

from ..accounts.shown_names import ShownNames
from ..database.states import EvaluationState
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey, read_stored_records
from ..evaluations.history import newest_evaluation
from ..evaluations.provenance import read_provenance
from ..principals import Principal
from ..visibility import require_episodes, visible


def export_log(session: Session, by: Principal, submission_id: UUID, task: str | None) -> bytes:
    """Return what was played for a submission, to be verified anywhere; a few MB.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: whose newest evaluation.
        task: which one; needed where there are several.

    Raises:
        ServiceError: there is no such submission or task, or its evaluation is not completed.
    """
    submission = visible(session, by, submission_id)
    evaluation = newest_evaluation(session, submission)
    require_episodes(by, evaluation)
    if not submission.kind.form.has_own_log:
        raise ServiceError(
            ProblemCode.NO_LOG, "The re-simulation of a 2025 text log is not an evaluation, so it has no log."
        )
    if evaluation.state is not EvaluationState.COMPLETED:
        raise ServiceError(
            ProblemCode.NO_LOG,
            f"Only a completed evaluation has a log; this one is {evaluation.state}.",
            state=evaluation.state.value,
        )
    chosen = submission.tasks[0] if task is None and len(submission.tasks) == 1 else task
    if chosen not in submission.tasks:
        raise ServiceError(
            ProblemCode.NO_LOG,
            f"A log is of one task: give `task`, one of {', '.join(submission.tasks)}.",
            tasks=submission.tasks,
        )
    header = LogHeader(
        team=ShownNames.read(session, by).show_name(submission.team),
        submission_digest=submission.digest if submission.kind.form.runs_policy else None,
        manifest=read_provenance(session, evaluation, chosen, evaluation.commitment or ""),
    )
    stream = BytesIO()
    write_log(stream, header, read_stored_records(session, EpisodeKey.from_evaluation(evaluation, submission), chosen))
    return stream.getvalue()
