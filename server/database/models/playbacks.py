"""Tables of playbacks: files that pages play, made by workers when somebody wants to see an episode."""

from datetime import datetime

from sqlalchemy import BigInteger, CheckConstraint, ForeignKey, Identity, Index, String, func, text
from sqlalchemy.orm import Mapped, mapped_column, relationship

from ..states import PlaybackState
from .base import Base, closed_set, sha256_check
from .evaluations import EpisodeResult


class Playback(Base):
    """The playback of an episode, by a key over all that it is made from: equal episodes share one.

    `token` rises with each claim: it fences off others. `asked_by` is whose limits count it.
    """

    __tablename__ = "playbacks"
    __table_args__ = (
        sha256_check("key"),
        sha256_check("scene_sha256"),
        sha256_check("cameras_sha256"),
        sha256_check("still_sha256"),
        sha256_check("film_sha256"),
        CheckConstraint("(state = 'running') = (lease_expires_at IS NOT NULL)", name="running_has_a_lease"),
        CheckConstraint(
            "(state = 'made') = (scene_sha256 IS NOT NULL OR film_sha256 IS NOT NULL)", name="made_has_scene_or_film"
        ),
        CheckConstraint("(state = 'failed') = (problem IS NOT NULL)", name="failed_has_a_problem"),
        CheckConstraint("attempts >= 0 AND token >= attempts AND env_steps_played >= 0", name="counts_from_zero"),
        Index("ix_playbacks_asked_by_asked_at", "asked_by", "asked_at"),
        Index("ix_playbacks_open", "state", postgresql_where=text("state IN ('queued', 'running')")),
    )
    id: Mapped[int] = mapped_column(BigInteger, Identity(always=True), primary_key=True)
    key: Mapped[str] = mapped_column(String(64), unique=True)
    episode_id: Mapped[int] = mapped_column(ForeignKey("episode_results.id", ondelete="CASCADE"), index=True)
    evaluator_version: Mapped[str]
    state: Mapped[PlaybackState] = mapped_column(closed_set(PlaybackState, "state"))
    asked_by: Mapped[str]
    asked_at: Mapped[datetime] = mapped_column(server_default=func.now(), index=True)
    finished_at: Mapped[datetime | None]
    env_steps_played: Mapped[int] = mapped_column(default=0)
    token: Mapped[int] = mapped_column(BigInteger, default=0)
    attempts: Mapped[int] = mapped_column(default=0)
    lease_expires_at: Mapped[datetime | None]
    problem: Mapped[str | None]
    scene_sha256: Mapped[str | None] = mapped_column(String(64))
    cameras_sha256: Mapped[str | None] = mapped_column(String(64))
    still_sha256: Mapped[str | None] = mapped_column(String(64))
    film_sha256: Mapped[str | None] = mapped_column(String(64))
    episode: Mapped[EpisodeResult] = relationship()
