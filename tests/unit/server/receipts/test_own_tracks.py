"""A board of an organizer's own track is audited where nobody has its file, which comes with the export."""

import os
import zipfile
from pathlib import Path

import pytest
from audited_boards import complete, environment_of, played_again
from databases import opened_database
from obstore.store import MemoryStore
from own_track import OWN_TRACK
from service_factories import make_principal, submit_to
from vitac.evaluator.tracks.registry import TRACKS_FOLDER_VARIABLE
from vitac.server.decisions.exporting import export_receipts
from vitac.server.receipts.audit import audit
from vitac.server.receipts.export import track_name
from vitac.server.storage.blobs import BlobStore

from competitions import shown_stage


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The board of an own track with one team, whose episodes were really played."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "pegs.yaml").write_text(OWN_TRACK)
    with pytest.MonkeyPatch.context() as patch, opened_database() as database:
        patch.setenv(TRACKS_FOLDER_VARIABLE, str(folder))
        env = environment_of("own-pegs")
        with database.transaction() as session:
            submission = submit_to(session, make_principal(session), track="pegs", task="own-pegs")
        complete(database, submission, env, lambda task, number: played_again(task, number, env))
        with database.snapshot() as session:
            path = folder / "board.zip"
            export_receipts(session, BlobStore(MemoryStore()), path, shown_stage(session, "pegs"))
    return path


def with_track_file(export: Path, content: bytes | None, folder: Path) -> Path:
    """The export with another file of its track; None: without one."""
    changed = folder / "changed.zip"
    with zipfile.ZipFile(export) as whole, zipfile.ZipFile(changed, "w") as made:
        for name in whole.namelist():
            if name != track_name("pegs"):
                made.writestr(name, whole.read(name))
        if content is not None:
            made.writestr(track_name("pegs"), content)
    return changed


def test_its_records_and_episodes_are_verified_with_the_track_file_of_the_export(export: Path) -> None:
    assert TRACKS_FOLDER_VARIABLE not in os.environ
    found = audit(export, episodes=1)
    assert (found.findings, found.unchecked, found.unverified) == ([], [], [])
    assert (found.logs, len(found.resimulated), found.is_believed) == (1, 1, True)
    assert TRACKS_FOLDER_VARIABLE not in os.environ


@pytest.mark.parametrize(
    "content",
    [None, b"", OWN_TRACK.replace("[1, 2, 3]", "[1, 2, 4]").encode(), OWN_TRACK.replace("Insert", "Push").encode()],
    ids=["missing", "empty", "other start", "other words"],
)
def test_another_track_file_or_none_is_never_believed(export: Path, tmp_path: Path, content: bytes | None) -> None:
    found = audit(with_track_file(export, content, tmp_path), episodes=1)
    assert found.logs == 0
    assert not found.is_believed
    assert found.findings or found.unchecked
