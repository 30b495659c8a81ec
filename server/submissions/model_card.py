"""The model card of a submission: what its manifest, its archive and its records say. Called by API and pages."""

from uuid import UUID

from sqlalchemy import Float, func, select
from sqlalchemy.orm import Session

from ..cache import Cache
from ..database.models import EpisodeResult, Evaluation
from ..database.states import EvaluationState
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey, find_shown_key
from ..evaluations.history import newest_evaluation
from ..leaderboards.public_pages import readable
from ..principals import Principal
from ..views.submissions import ArchiveContents, ModelCardView

_times: Cache[UUID, float] = Cache(at_most=1024)
"""By evaluation: to sum them up, the database unpacks every record."""


def model_card(session: Session, by: Principal, submission_id: UUID) -> ModelCardView:
    """Return the card of a model.

    Raises:
        ServiceError: there is no such submission, or it is a log.
    """
    submission = readable(session, by, submission_id)
    if not submission.kind.form.runs_policy:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"Expected a model, got a {submission.kind}: only models have a card.",
        )
    return make_card(session, by, newest_evaluation(session, submission))


def make_card(session: Session, by: Principal, evaluation: Evaluation) -> ModelCardView:
    """Return the card of an evaluated model."""
    submission = evaluation.submission
    contents = submission.contents
    return ModelCardView(
        name=submission.name,
        track=submission.track,
        tasks=submission.tasks,
        observation_keys=submission.manifest.get("observation_keys"),
        control_modes=submission.manifest.get("control_modes") or {},
        archive_bytes=submission.archive_bytes,
        contents=None if contents is None else ArchiveContents.model_validate(contents),
        policy_ms=_find_policy_ms(session, by, evaluation),
    )


def _find_policy_ms(session: Session, by: Principal, evaluation: Evaluation) -> float | None:
    key = find_shown_key(session, by, evaluation)
    if key is None or evaluation.state is not EvaluationState.COMPLETED:
        return None
    return _times.get(evaluation.id, lambda: _read_policy_ms(session, key))


def _read_policy_ms(session: Session, key: EpisodeKey) -> float:
    policy_s = EpisodeResult.record[("timings", "policy_s")].astext.cast(Float)
    total_s, env_steps = session.execute(
        select(func.sum(policy_s), func.sum(EpisodeResult.env_steps)).where(*key.conditions())
    ).one()
    return 1000.0 * (total_s or 0.0) / max(1, env_steps or 0)
