"""The stored files of playbacks."""

from enum import StrEnum

from sqlalchemy import delete
from sqlalchemy.orm import Session

from ..database.engine import Database
from ..database.models import EpisodeResult, Playback
from ..errors import not_found
from ..storage.blobs import BlobStore, StoredFileLost
from .asking import find_playback


class PlaybackFile(StrEnum):
    """What a page plays or shows of a playback."""

    SCENE = "scene"
    """What moves, and what is plotted; compressed with gzip."""
    CAMERAS = "cameras"
    """What the camera rig saw; compressed with gzip."""
    STILL = "still"
    """The end of the episode as the player first shows its scene, or the last picture of the film; WebP."""
    FILM = "film"
    """Pictures of an episode of ManiSkill one after the other, an animated WebP."""


def find_digest(session: Session, episode: EpisodeResult, file: PlaybackFile) -> str:
    """Return the SHA-256 of a file of an episode's playback.

    Raises:
        ServiceError: there is none.
    """
    playback = find_playback(session, episode)
    digest = None if playback is None else getattr(playback, f"{file.value}_sha256")
    if digest is None:
        raise not_found("playback file", file.value)
    return str(digest)


def read(database: Database, blobs: BlobStore, digest: str) -> bytes:
    """Return a file; where it is lost, its playback is removed, so that it is made again when somebody asks.

    Raises:
        ServiceError: it is lost or the store cannot be read.
    """
    try:
        return blobs.read(digest)
    except StoredFileLost as error:
        with database.transaction() as session:
            lost = (Playback.scene_sha256, Playback.cameras_sha256, Playback.still_sha256, Playback.film_sha256)
            for column in lost:
                session.execute(delete(Playback).where(column == digest))
        raise not_found("playback file", digest) from error
