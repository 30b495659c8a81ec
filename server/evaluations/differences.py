"""Episodes that were played again with another record than the stored one: an alarm for the organizers.

The first record counts. Another one under the same key means that the policy or a machine does not repeat itself.
"""

from collections.abc import Collection
from uuid import UUID

import structlog
from sqlalchemy import ScalarSelect, func, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..database.engine import among
from ..database.models import EpisodeDifference, Evaluation, Work
from ..queue.leases import Lease
from ..views.evaluations import DifferingEpisodeView

logger = structlog.get_logger(__name__)


def report_difference(session: Session, lease: Lease, *, episode: int, stored: str, differing: str) -> None:
    """Keep an alarm with the evaluation; the same one again changes nothing.

    Args:
        session: of the transaction.
        lease: under which the episode was played again.
        episode: its number.
        stored: digest of the record that counts.
        differing: digest of the new record.
    """
    worker = select(Work.worker_id).where(Work.id == lease.work_id).scalar_subquery()
    session.execute(
        insert(EpisodeDifference)
        .values(
            evaluation_id=lease.evaluation_id,
            task=lease.task,
            episode=episode,
            stored_digest=stored,
            differing_digest=differing,
            worker_id=worker,
        )
        .on_conflict_do_nothing(constraint="uq_episode_differences_key")
    )
    logger.error("episode_differs_from_stored", shard=lease.work_id, episode=episode, stored=stored, new=differing)


def differing_episodes(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, list[DifferingEpisodeView]]:
    """Return the alarms of each evaluation, in the order of the episodes."""
    found: dict[UUID, list[DifferingEpisodeView]] = {evaluation.id: [] for evaluation in evaluations}
    rows = session.scalars(
        select(EpisodeDifference)
        .where(among(EpisodeDifference.evaluation_id, found))
        .order_by(EpisodeDifference.task, EpisodeDifference.episode, EpisodeDifference.id)
    )
    for row in rows:
        found[row.evaluation_id].append(DifferingEpisodeView.model_validate(row, from_attributes=True))
    return found


def count_differing_episodes() -> ScalarSelect[int]:
    """Return how many episodes of a row of `evaluations` differ, for a query on them."""
    episodes = (
        select(EpisodeDifference.task, EpisodeDifference.episode)
        .where(EpisodeDifference.evaluation_id == Evaluation.id)
        .correlate(Evaluation)
        .distinct()
        .subquery()
    )
    return select(func.count()).select_from(episodes).scalar_subquery()
