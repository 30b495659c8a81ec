"""The sensor of a submission, and what sensing adds; called by API and pages."""

from collections.abc import Sequence
from uuid import UUID

from sqlalchemy.orm import Session
from vitac.evaluator.scoring.comparison import RunsDiffer, SensingGain, sensing_gain
from vitac.evaluator.tracks import Player, load_track

from ..database.models import Submission, SubmissionFile
from ..database.states import EvaluationState, FileRole
from ..errors import not_found
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..views.submissions import DocumentView, EpisodeView, SensorView
from ..visibility import decide_sight, visible
from .figures import coefficients_digest, read_figures
from .files import find_file
from .listing import episodes


def sensor(session: Session, by: Principal, submission_id: UUID) -> SensorView:
    """Return the sensor of a submission; of its figures only those without starts where episodes are not shown.

    Raises:
        ServiceError: there is no such submission, or it has no sensor.
    """
    submission = visible(session, by, submission_id)
    made, described = (_file(session, submission_id, role) for role in (FileRole.SENSOR, FileRole.DOCUMENT))
    evaluation = newest_evaluation(session, submission)
    return SensorView(
        digest=made.sha256,
        **made.facts,
        document=DocumentView(name=described.name, n_bytes=described.n_bytes, sha256=described.sha256),
        coefficients_sha256=coefficients_digest(session, submission_id, evaluation.id, made.sha256),
        gain=_gain(session, by, submission),
        figures=read_figures(session, submission, evaluation, with_starts=decide_sight(by, evaluation).episodes),
    )


def document(session: Session, by: Principal, submission_id: UUID) -> DocumentView:
    """Return where the design document of a submission is stored.

    Raises:
        ServiceError: there is no such submission, or it has no document.
    """
    visible(session, by, submission_id)
    found = _file(session, submission_id, FileRole.DOCUMENT)
    return DocumentView(name=found.name, n_bytes=found.n_bytes, sha256=found.sha256)


def to_save(submission_id: UUID, document: DocumentView) -> dict[str, str]:
    """Return the headers with which a document is handed out: browsers save it, and neither show nor guess what it is.

    Args:
        submission_id: whose.
        document: as it is stored.
    """
    return {
        "Content-Type": "application/octet-stream",
        "Content-Disposition": f'attachment; filename="{submission_id}-{document.name}"',
        "X-Content-Type-Options": "nosniff",
        "Content-Security-Policy": "sandbox; default-src 'none'",
    }


def _file(session: Session, submission_id: UUID, role: FileRole) -> SubmissionFile:
    found = find_file(session, submission_id, role)
    if found is None:
        raise not_found(f"{role} of submission", submission_id)
    return found


def _gain(session: Session, by: Principal, submission: Submission) -> SensingGain | None:
    """Return the gain; None where its two runs are not over, not both played, or their episodes not shown."""
    evaluation = newest_evaluation(session, submission)
    if evaluation.state is not EvaluationState.COMPLETED or not decide_sight(by, evaluation).episodes:
        return None
    players = {task.player: name for name, task in load_track(submission.track).tasks.items()}
    ends = episodes(session, by, submission.id)
    try:
        return sensing_gain(_select_task(ends, players[Player.ESTIMATOR]), _select_task(ends, players[Player.BLIND]))
    except RunsDiffer:
        return None


def _select_task(ends: Sequence[EpisodeView], task: str) -> list[EpisodeView]:
    return [end for end in ends if end.task == task]
