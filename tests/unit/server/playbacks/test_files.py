import hashlib
from pathlib import Path

import pytest
from asked_playbacks import Played
from obstore.store import MemoryStore
from service_factories import take
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.playbacks import work
from vitac.server.playbacks.asking import PlaybackFile, find_digest
from vitac.server.playbacks.work import read_file
from vitac.server.storage.blobs import BlobStore

SCENE = b"all that moves"
DIGEST = hashlib.sha256(SCENE).hexdigest()


@pytest.fixture
def made(team_a: Played) -> Played:
    """A playback without cameras and still."""
    playback = team_a.ask(1)
    with team_a.database.transaction() as session:
        work.end_made(session, work.begin(session, take(session, playback.id)), {"scene_sha256": DIGEST})
    return team_a


def digest(made: Played, file: PlaybackFile, number: int = 1) -> str:
    with made.database.transaction() as session:
        return find_digest(session, made.episode(number), file)


def test_a_file_is_read_by_its_digest(made: Played, tmp_path: Path) -> None:
    blobs = BlobStore(MemoryStore())
    path = tmp_path / "scene"
    path.write_bytes(SCENE)
    blobs.put(path, DIGEST)
    assert read_file(made.database, blobs, digest(made, PlaybackFile.SCENE)) == SCENE


@pytest.mark.parametrize(
    ("file", "number"), [(PlaybackFile.CAMERAS, 1), (PlaybackFile.STILL, 1), (PlaybackFile.SCENE, 2)]
)
def test_a_file_that_was_not_made_is_not_found(made: Played, file: PlaybackFile, number: int) -> None:
    with pytest.raises(ServiceError) as refused:
        digest(made, file, number)
    assert refused.value.code is ProblemCode.NOT_FOUND


def test_a_playback_whose_file_is_lost_can_be_asked_for_again(made: Played) -> None:
    first = made.ask(1).id
    with pytest.raises(ServiceError) as refused:
        read_file(made.database, BlobStore(MemoryStore()), DIGEST)
    assert refused.value.code is ProblemCode.NOT_FOUND
    assert made.found(1) is None
    assert made.ask(1).id != first
