"""Tables of playbacks: files that pages play, made by workers when somebody wants to see an episode."""

from datetime import datetime

from sqlalchemy import CheckConstraint, ForeignKey, Index, String, func
from sqlalchemy.orm import Mapped, mapped_column, relationship

from ..states import WorkKind
from .base import sha256_check
from .evaluations import EpisodeResult
from .work import Work


class Playback(Work):
    """The playback of an episode, by a key over all that it is made from: equal episodes share one.

    Its `owner` is whose limits count it.
    """

    __tablename__ = "playbacks"
    __table_args__ = (
        sha256_check("key"),
        sha256_check("scene_sha256"),
        sha256_check("cameras_sha256"),
        sha256_check("still_sha256"),
        sha256_check("film_sha256"),
        CheckConstraint("env_steps_played >= 0", name="counts_from_zero"),
        Index("ix_playbacks_asked_at", "asked_at"),
    )
    id: Mapped[int] = mapped_column(ForeignKey("work.id", ondelete="CASCADE"), primary_key=True)
    key: Mapped[str] = mapped_column(String(64), unique=True)
    episode_id: Mapped[int] = mapped_column(ForeignKey("episode_results.id", ondelete="CASCADE"), index=True)
    evaluator_version: Mapped[str]
    asked_at: Mapped[datetime] = mapped_column(server_default=func.now())
    env_steps_played: Mapped[int] = mapped_column(default=0)
    scene_sha256: Mapped[str | None] = mapped_column(String(64))
    cameras_sha256: Mapped[str | None] = mapped_column(String(64))
    still_sha256: Mapped[str | None] = mapped_column(String(64))
    film_sha256: Mapped[str | None] = mapped_column(String(64))
    episode: Mapped[EpisodeResult] = relationship()
    __mapper_args__ = {"polymorphic_identity": WorkKind.PLAYBACK}  # noqa: RUF012 - SQLAlchemy reads it
