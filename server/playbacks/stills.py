"""Stills of a result's episodes, from their playbacks. Called by the pages that show results and the housekeeping."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import cache
from uuid import UUID

from sqlalchemy import Select, and_, exists, func, select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session, aliased, contains_eager
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.tracks.registry import current_versions

from ..database.engine import among_parameter
from ..database.models import EpisodeResult, Evaluation, Playback, Submission
from ..database.states import EvaluationState, WorkState
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import find_shown_key
from ..evaluations.history import newest_evaluation, select_newest
from ..leaderboards.public_pages import public_among, readable
from ..principals import CONSOLE, VISITOR, Principal
from ..settings import Settings
from ..views.comparisons import PublicEpisodeView, ShownEpisodeView, StillView
from .asking import ask, playback_key, shown_episode

LOOKED_AFTER = 100
"""Maximum number of public results, the newest first, that get stills before anybody asks."""
ASKED_AT_ONCE = 3
"""Maximum number of results whose stills are asked for in one call, so that its transaction is short."""


def list_stills(session: Session, by: Principal, submission_id: UUID) -> Sequence[StillView]:
    """Return for each task and end of a submission's episodes the first one that has a still; only what `by` may see.

    Raises:
        ServiceError: there is no such submission that the principal may see.
    """
    key = find_shown_key(session, by, newest_evaluation(session, readable(session, by, submission_id)))
    if key is None:
        return ()
    rows = session.execute(
        select(EpisodeResult, Playback.key)
        .join(Playback, Playback.episode_id == EpisodeResult.id)
        .where(*key.conditions(), Playback.still_sha256.is_not(None))
        .order_by(EpisodeResult.task, EpisodeResult.outcome, EpisodeResult.episode)
        .ext(distinct_on(EpisodeResult.task, EpisodeResult.outcome))
    )
    return [_view(result, shown) for result, shown in rows if shown == playback_key(result)]


def find_stills(session: Session, by: Principal, submissions: Collection[UUID]) -> Mapping[UUID, StillView]:
    """Return a still of each submission that has one: of a success, if there is any.

    Args:
        session: of the transaction.
        by: who asks; of sealed lists only organizers get stills.
        submissions: ids of some that `by` may see.
    """
    rows = session.execute(_select_stills(), {"submissions": list(submissions)})
    return {
        evaluation.submission_id: _view(result, shown)
        for evaluation, result, shown in rows
        if shown == playback_key(result) and find_shown_key(session, by, evaluation) is not None
    }


@cache
def _select_stills() -> Select[Evaluation, EpisodeResult, str]:
    """Return the query of the stills of `submissions`, put together once: each page of submissions asks it."""
    newest = aliased(Evaluation)
    key = and_(
        EpisodeResult.submission_digest == Submission.digest,
        EpisodeResult.track == Submission.track,
        EpisodeResult.evaluator_version == newest.evaluator_version,
        EpisodeResult.run == newest.run,
        EpisodeResult.commitment == func.coalesce(newest.commitment, ""),
    )
    return (
        select(newest, EpisodeResult, Playback.key)
        .join(Submission, Submission.id == newest.submission_id)
        .join(EpisodeResult, key)
        .join(Playback, Playback.episode_id == EpisodeResult.id)
        .where(
            among_parameter(Submission.id, "submissions"),
            newest.id == select_newest(Evaluation.id),
            Playback.still_sha256.is_not(None),
        )
        .options(contains_eager(newest.submission))
        .order_by(Submission.id, EpisodeResult.success.desc(), EpisodeResult.task, EpisodeResult.episode)
        .ext(distinct_on(Submission.id))
    )


def _view(result: EpisodeResult, key: str) -> StillView:
    return StillView(task=result.task, episode=result.episode, outcome=EpisodeOutcome(result.outcome), key=key)


def ask_for_missing_stills(session: Session, settings: Settings, seen: set[UUID]) -> None:
    """Ask for stills of the newest public results that have no playback, those of some in each call.

    Those of new results are asked for already. What they take on the disk is bounded: two playbacks for each task of
    at most `LOOKED_AFTER` results; they are removed as others are.

    Args:
        session: of the transaction.
        settings: of the service.
        seen: evaluations that were asked for, even where there can be no still; grows.
    """
    newest = (
        select(
            Submission.id, Submission.digest, Submission.track, Evaluation.id.label("by"), Evaluation.evaluator_version
        )
        .join(Evaluation, Evaluation.submission_id == Submission.id)
        .where(
            Submission.is_public,
            Evaluation.state == EvaluationState.COMPLETED,
            Evaluation.evaluator_version.in_(current_versions()),
        )
        .order_by(Evaluation.finished_at.desc())
        .limit(LOOKED_AFTER)
        .subquery()
    )
    has_playback = exists().where(
        EpisodeResult.submission_digest == newest.c.digest,
        EpisodeResult.track == newest.c.track,
        EpisodeResult.evaluator_version == newest.c.evaluator_version,
        Playback.episode_id == EpisodeResult.id,
    )
    rows = session.execute(select(newest.c.by, newest.c.id).where(~has_playback)).all()
    asked = [(evaluation, submission) for evaluation, submission in rows if evaluation not in seen][:ASKED_AT_ONCE]
    public = public_among(session, [submission for _, submission in asked])
    for evaluation, submission in asked:
        seen.add(evaluation)
        if submission in public:
            _ask_for_stills(session, settings, submission)


def ask_for_new_stills(session: Session, settings: Settings, evaluation_id: UUID) -> None:
    """Ask for the stills of a result at once, if everybody may see it; called when a shard has ended."""
    evaluation = session.get_one(Evaluation, evaluation_id)
    if evaluation.state is not EvaluationState.COMPLETED:
        return
    if evaluation.submission_id in public_among(session, [evaluation.submission_id]):
        _ask_for_stills(session, settings, evaluation.submission_id)


def _ask_for_stills(session: Session, settings: Settings, submission_id: UUID) -> None:
    """Ask for the playbacks of the first success and the first failure in each task that everybody may see."""
    key = find_shown_key(session, VISITOR, newest_evaluation(session, readable(session, VISITOR, submission_id)))
    if key is None:
        return
    first = (
        select(EpisodeResult)
        .where(*key.conditions())
        .order_by(EpisodeResult.task, EpisodeResult.success, EpisodeResult.episode)
        .ext(distinct_on(EpisodeResult.task, EpisodeResult.success))
    )
    for episode in session.scalars(first):
        with suppress(ServiceError):
            ask(session, settings, CONSOLE, episode)


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
