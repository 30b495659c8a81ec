"""The playback that the front page plays: the newest one of an episode that everybody may see. Called by the pages."""

from uuid import UUID

from sqlalchemy import and_, select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks.registry import current_versions

from ..database.models import EpisodeResult, Playback, Submission
from ..database.states import WorkState
from ..errors import ProblemCode, ServiceError
from ..leaderboards.public_pages import public_among
from ..principals import VISITOR
from ..settings import Settings
from ..views.playbacks import PublicEpisodeView, ShownEpisodeView
from .asking import shown_episode

LOOKED_AT = 100
"""Maximum number of playbacks, and of submissions that have them, to look at; the last requested first."""


def newest_public_episode(session: Session, settings: Settings) -> PublicEpisodeView | None:
    """Return the solved episode of a public submission whose playback was asked for last and is made; or None."""
    newest = (
        select(Playback.episode_id, Playback.asked_at)
        .where(Playback.scene_sha256.is_not(None), Playback.evaluator_version.in_(current_versions()))
        .order_by(Playback.asked_at.desc())
        .limit(LOOKED_AT)
        .subquery()
    )
    played = and_(Submission.digest == EpisodeResult.submission_digest, Submission.track == EpisodeResult.track)
    rows = session.execute(
        select(Submission.id, EpisodeResult.task, EpisodeResult.episode)
        .select_from(newest)
        .join(EpisodeResult, EpisodeResult.id == newest.c.episode_id)
        .join(Submission, played)
        .where(Submission.is_public, EpisodeResult.success)
        .order_by(newest.c.asked_at.desc(), Submission.submitted_at, Submission.id)
        .limit(LOOKED_AT)
    ).all()
    public = public_among(session, {submission_id for submission_id, _, _ in rows})
    for submission_id, task, number in rows:
        shown = _shown(session, settings, submission_id, task, number) if submission_id in public else None
        if shown is not None:
            return PublicEpisodeView(submission_id=submission_id, shown=shown)
    return None


def _shown(
    session: Session, settings: Settings, submission_id: UUID, task: str, number: int
) -> ShownEpisodeView | None:
    """Return the episode of a submission's newest evaluation if visitors may see it, and its playback is made."""
    try:
        shown = shown_episode(session, settings, VISITOR, submission_id, task, number)
    except ServiceError as error:
        # Made private in this moment, or of a sealed list.
        if error.code in {ProblemCode.MISSING_CREDENTIALS, ProblemCode.NOT_FOUND}:
            return None
        raise
    is_made = shown.playback is not None and shown.playback.state is WorkState.DONE
    return shown if is_made else None
