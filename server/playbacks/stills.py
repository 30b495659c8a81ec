"""Stills of a result's episodes, from their playbacks. Called by the page of a submission and the demo."""

from collections.abc import Sequence
from contextlib import suppress
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.dialects.postgresql import distinct_on
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome

from ..db.models import EpisodeResult, Playback
from ..errors import ServiceError
from ..evaluations.episode_store import find_shown_key
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..settings import Settings
from ..sharing.public_pages import readable
from ..views.playbacks import StillView
from .asking import ask, playback_key


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
    return [
        StillView(task=found.task, episode=found.episode, outcome=EpisodeOutcome(found.outcome), key=shown)
        for found, shown in rows
        if shown == playback_key(found)
    ]


def ask_for_stills(session: Session, settings: Settings, by: Principal, submission_id: UUID) -> None:
    """Ask for the playbacks of the first success and the first failure in each task, where they can be made."""
    key = find_shown_key(session, by, newest_evaluation(session, readable(session, by, submission_id)))
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
            ask(session, settings, by, episode)
