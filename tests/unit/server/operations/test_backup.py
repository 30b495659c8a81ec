"""The members of a backup: written in order, and read back only as they were written; without a database."""

import errno
import hashlib
import io
import json
import re
import stat
import tarfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from databases import fresh_database
from every_table import fill_every_table, rows_of_every_table
from httpx import Client
from service_client import API, Service, bearer, make_archive, running_service, serving
from service_factories import forget_boards, make_principal, make_settings, play_all
from sqlalchemy import func, select
from vitac.server.api.app import create_app
from vitac.server.audit import newest_entries
from vitac.server.database import binaries, engine
from vitac.server.database.engine import Database
from vitac.server.database.locks import AdvisoryLock, try_lock
from vitac.server.database.models import Evaluation, Submission, Team, Worker
from vitac.server.database.schema import explain_other_schema
from vitac.server.database.states import WorkerState
from vitac.server.operations.backup import (
    BLOB_FOLDER,
    DESCRIPTION_NAME,
    DUMP_NAME,
    BackupDescription,
    BackupNotMade,
    BackupReader,
    BackupRejected,
    BackupWriter,
    ServiceNotEmpty,
    back_up,
    check,
    restore,
)
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore

Members = dict[str, bytes]


@pytest.fixture
def service(database: Database, tmp_path: Path) -> Iterator[Service]:
    with running_service(database, tmp_path / "state") as service:
        yield service


@pytest.fixture
def empty(tmp_path: Path) -> Iterator[Services]:
    """Open services without any data, whose database is of no other test: a restored schema is worded differently."""
    with fresh_database() as address:
        settings, database = make_settings(state_dir=tmp_path / "new"), Database(address)
        settings.scratch_dir.mkdir(parents=True)
        yield Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)
        database.dispose()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "backup.tar"


def upload_and_play(service: Service, name: str = "zero") -> str:
    answer = service.upload(make_archive(manifest=f"track: track_1\ntasks: [peg-insertion]\nname: {name}\n"))
    assert answer.status_code == 202, answer.text
    with service.database.transaction() as session:
        submission = session.get_one(Submission, UUID(answer.json()["id"]))
        digest = submission.archive_sha256
    play_all(service.database, submission)
    return digest


@contextmanager
def rewritten(file: Path, change: Callable[[Members], None]) -> Iterator[Path]:
    """Return a copy of a backup whose members were changed."""
    with tarfile.open(file) as tar:
        members = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    change(members)
    copy = file.with_name("changed.tar")
    with tarfile.open(copy, "w") as tar:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    yield copy


def undated(answer: bytes) -> bytes:
    """Return an answer without the moment at which it was made."""
    return re.sub(rb'"generated_at":"[^"]+"', b"", answer)


def count(services: Services, model: type) -> int:
    with services.database.transaction() as session:
        return session.scalar(select(func.count()).select_from(model)) or 0


def test_restored_service_shows_the_same_boards_byte_for_byte(
    service: Service, empty: Services, file: Path, tmp_path: Path
) -> None:
    digest = upload_and_play(service)
    pages = (
        "/leaderboards/track_1",
        "/leaderboards/track_1?task=peg-insertion",
        "/submissions",
        "/tracks",
        "/receipts",
    )
    before = {page: undated(service.get(page).content) for page in pages}
    description = back_up(service.services, file)
    assert description.blobs == (digest,)
    untouched = rows_of_every_table(empty.database)
    assert check(empty, file) == description
    assert rows_of_every_table(empty.database) == untouched
    assert restore(empty, file) == description
    with empty.database.engine.connect() as connection:
        assert explain_other_schema(connection) is None
    forget_boards()
    with serving(create_app(empty.settings, services=empty)) as (host, port):
        restored = f"http://{host}:{port}{API}"
        with Client(base_url=restored, headers=bearer(service.token)) as client:
            after = {page: undated(client.get(page).content) for page in pages}
    assert after == before
    empty.blobs.fetch(digest, tmp_path / "blob")
    assert (tmp_path / "blob").read_bytes() == make_archive()


def test_every_row_of_every_table_comes_back_as_it_was(service: Service, empty: Services, file: Path) -> None:
    digest = upload_and_play(service)
    with service.database.transaction() as session:
        evaluation = session.scalars(select(Evaluation)).one()
        fill_every_table(session, evaluation.submission, evaluation, digest)
    before = rows_of_every_table(service.database)
    assert [table for table, rows in before.items() if not rows] == [], "fill these as well"
    back_up(service.services, file)
    restore(empty, file)
    after = rows_of_every_table(empty.database)
    assert len(after["audit_log"]) == len(before["audit_log"]) + 1
    assert set(after.pop("audit_log")) > set(before.pop("audit_log"))
    for in_pieces in ("partial_uploads", "upload_parts"):
        assert before.pop(in_pieces), "which no backup has"
        assert after.pop(in_pieces) == []
    assert after == before


def test_backup_leaves_out_what_arrives_while_it_is_written(service: Service, empty: Services, file: Path) -> None:
    digest = upload_and_play(service)

    def upload_another(done: int, total: int) -> None:
        upload_and_play(service, "second")

    description = back_up(service.services, file, report_file=upload_another)
    restore(empty, file)
    assert description.blobs == (digest,)
    assert count(empty, Submission) == 1


def test_backup_is_for_its_owner_alone(service: Service, file: Path) -> None:
    back_up(service.services, file)
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_existing_file_is_kept(service: Service, file: Path) -> None:
    file.write_text("precious")
    with pytest.raises(BackupNotMade, match="exists"):
        back_up(service.services, file)
    assert file.read_text() == "precious"


def test_file_that_appears_while_the_backup_is_written_is_kept(service: Service, file: Path) -> None:
    upload_and_play(service)

    def write_another(done: int, total: int) -> None:
        file.write_text("precious")

    with pytest.raises(BackupNotMade, match="exists"):
        back_up(service.services, file, report_file=write_another)
    assert file.read_text() == "precious"
    assert list(file.parent.glob("backup*")) == [file]


def test_backup_is_made_where_the_file_system_has_no_hard_links(
    service: Service, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    back_up(service.services, file)
    with BackupReader.opened(file) as reader:
        reader.check()


def test_a_dump_may_take_longer_than_a_transaction_may_stand_still(
    service: Service, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "LIMITS", ("SET idle_in_transaction_session_timeout = '1s'",))
    dump = binaries.dump_database

    def dump_slowly(*arguments: Any, **options: Any) -> None:
        threading.Event().wait(1.1)
        dump(*arguments, **options)

    monkeypatch.setattr(binaries, "dump_database", dump_slowly)
    impatient = Database(service.database.address)
    back_up(replace(service.services, database=impatient), file)
    impatient.dispose()
    with BackupReader.opened(file) as reader:
        reader.check()


def test_folder_that_is_missing_is_named(service: Service, tmp_path: Path) -> None:
    with pytest.raises(BackupNotMade, match="No such file"):
        back_up(service.services, tmp_path / "none" / "backup.tar")


def test_nothing_is_left_where_an_upload_cannot_be_read(service: Service, file: Path) -> None:
    digest = upload_and_play(service)
    service.services.blobs.delete(digest)
    with pytest.raises(Exception, match="is gone"):
        back_up(service.services, file)
    assert list(file.parent.glob("backup*")) == []


def test_service_with_data_is_left_as_it_is(service: Service, file: Path) -> None:
    upload_and_play(service)
    back_up(service.services, file)
    with pytest.raises(ServiceNotEmpty, match="got 2 teams, 3 api_tokens, 1 submissions"):
        restore(service.services, file)
    with pytest.raises(ServiceNotEmpty, match="restore into a new one"):
        check(service.services, file)
    assert count(service.services, Team) == 2


def test_service_with_running_workers_is_left_as_it_is(service: Service, empty: Services, file: Path) -> None:
    back_up(service.services, file)
    with empty.database.transaction() as session:
        session.add(
            Worker(
                host="test",
                pid=1,
                slots=1,
                state=WorkerState.READY,
                evaluator_version="1",
                platform_class="x",
                isolation="",
                message="",
            )
        )
    with pytest.raises(ServiceNotEmpty, match="got 1; stop them"):
        restore(empty, file)


def test_team_that_registers_during_a_restore_is_kept(service: Service, empty: Services, file: Path) -> None:
    upload_and_play(service)
    back_up(service.services, file)

    def register_team(done: int, total: int) -> None:
        with empty.database.transaction() as session:
            make_principal(session, "early")

    with pytest.raises(ServiceNotEmpty, match="got 1 teams"):
        restore(empty, file, report_file=register_team)
    with empty.database.transaction() as session:
        assert session.scalars(select(Team.name)).all() == ["early"]


def test_no_other_process_migrates_while_the_database_is_written(
    service: Service, empty: Services, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    back_up(service.services, file)
    free = []
    write = binaries.restore_database

    def look_and_write(address: str, dump_file: Path, *, bin_dir: Path | None = None) -> None:
        with empty.database.transaction() as session:
            free.append(try_lock(session, AdvisoryLock.SCHEMA_UPGRADE))
        write(address, dump_file, bin_dir=bin_dir)

    monkeypatch.setattr(binaries, "restore_database", look_and_write)
    restore(empty, file)
    assert free == [False]


def test_a_restored_service_says_where_it_comes_from(
    service: Service, empty: Services, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And brings the organizers' own track files along."""
    folders = [tmp_path / "tracks", tmp_path / "restored"]
    folders[0].mkdir()
    (folders[0] / "mine.yaml").write_text("name: mine")
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(folders[0]))
    made = back_up(service.services, file)
    monkeypatch.delenv("VITAC_TRACKS_DIR")
    with pytest.raises(BackupRejected, match="expected a folder for them"):
        check(empty, file)
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(folders[1]))
    assert check(empty, file).track_files == {"mine": "name: mine"}
    assert not folders[1].exists(), "a check changes nothing"
    restore(empty, file)
    assert (folders[1] / "mine.yaml").read_text() == "name: mine"
    with empty.database.transaction() as session:
        newest = newest_entries(session, 1)[0]
    assert (newest.action, newest.subject) == ("service.restore", f"file:{file.name}")
    assert newest.after == {"made_at": made.made_at.isoformat()}


def drop_dump(members: Members) -> None:
    del members["database.dump"]


def alter_blob(members: Members) -> None:
    name = next(name for name in members if name.startswith("blobs/"))
    members[name] += b"x"


def make_newer(members: Members) -> None:
    text = members["backup.json"].decode()
    revision = text.split('"schema_revision": "')[1].split('"')[0]
    members["backup.json"] = text.replace(f'"schema_revision": "{revision}"', '"schema_revision": "9999"').encode()


def make_another_format(members: Members) -> None:
    members["backup.json"] = members["backup.json"].replace(b'"format": 1', b'"format": 2')


def add_unknown_key(members: Members) -> None:
    members["backup.json"] = b'{"surprise": 1}'


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (drop_dump, "no file database.dump"),
        (alter_blob, "was altered"),
        (make_newer, "does not know"),
        (make_another_format, "This backup has format 2"),
        (add_unknown_key, "backup.json"),
    ],
)
def test_backup_that_is_not_whole_is_refused_before_anything_changes(
    service: Service, empty: Services, file: Path, change: Callable[[Members], None], reason: str
) -> None:
    upload_and_play(service)
    back_up(service.services, file)
    with rewritten(file, change) as changed:
        for bring in (check, restore):
            with pytest.raises(BackupRejected, match=reason):
                bring(empty, changed)
    with empty.database.engine.connect() as connection:
        assert explain_other_schema(connection) is None
    assert list(empty.settings.state_dir.rglob("sha256/*/*")) == []


DUMP = b"the dump of a database"
BLOBS = [b"", b"an upload", b"a longer upload" * 100_000]


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def description(**changes: Any) -> BackupDescription:
    return BackupDescription(
        **{
            "made_at": datetime(2025, 3, 1, tzinfo=UTC),
            "release": "0.1.0",
            "schema_revision": "v0001",
            "dump_sha256": digest(DUMP),
            "blobs": tuple(map(digest, BLOBS)),
            **changes,
        }
    )


@pytest.fixture
def backup(tmp_path: Path) -> Path:
    """A whole backup."""
    path = tmp_path / "backup.tar"
    with tarfile.open(path, "w:") as tar:
        writer = BackupWriter(tar)
        writer.describe(description())
        for name, content in {DUMP_NAME: DUMP, **{f"{BLOB_FOLDER}/{digest(blob)}": blob for blob in BLOBS}}.items():
            (tmp_path / "content").write_bytes(content)
            writer.add(name, tmp_path / "content")
    return path


def rewrite(path: Path, change: Callable[[Members], object]) -> None:
    """Write a backup anew with changed members."""
    with tarfile.open(path) as tar:
        members = {member.name: tar.extractfile(member).read() for member in tar}  # type: ignore[union-attr]
    change(members)
    with tarfile.open(path, "w:") as tar:
        for name, content in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))


def test_a_backup_holds_its_description_first_then_dump_and_uploads(backup: Path) -> None:
    with tarfile.open(backup) as tar:
        names = tar.getnames()
    assert names == [DESCRIPTION_NAME, DUMP_NAME, *(f"{BLOB_FOLDER}/{digest(blob)}" for blob in BLOBS)]
    assert (DESCRIPTION_NAME, DUMP_NAME, BLOB_FOLDER) == ("backup.json", "database.dump", "blobs")


def test_what_was_written_is_read_back(backup: Path, tmp_path: Path) -> None:
    with BackupReader.opened(backup) as reader:
        assert reader.description == description()
        reader.check()
        reader.extract_dump(tmp_path / "dump")
        assert (tmp_path / "dump").read_bytes() == DUMP
        for number, blob in enumerate(BLOBS):
            reader.extract_blob(digest(blob), tmp_path / str(number))
            assert (tmp_path / str(number)).read_bytes() == blob


def test_a_description_is_json_that_people_can_read(backup: Path) -> None:
    with tarfile.open(backup) as tar:
        content = tar.extractfile(DESCRIPTION_NAME).read()  # type: ignore[union-attr]
    assert json.loads(content)["format"] == 1
    assert content.count(b"\n") > 5


def test_extracting_overwrites_nothing(backup: Path, tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"kept")
    with BackupReader.opened(backup) as reader:
        with pytest.raises(FileExistsError):
            reader.extract_dump(tmp_path / "there")
        with pytest.raises(FileExistsError):
            reader.extract_blob(digest(BLOBS[1]), tmp_path / "there")
    assert (tmp_path / "there").read_bytes() == b"kept"


BLOB = f"{BLOB_FOLDER}/{digest(BLOBS[1])}"


@pytest.mark.parametrize("name", [DUMP_NAME, BLOB])
def test_a_member_that_is_missing_is_named(backup: Path, name: str) -> None:
    rewrite(backup, lambda members: members.pop(name))
    with BackupReader.opened(backup) as reader, pytest.raises(BackupRejected) as refused:
        reader.check()
    assert str(refused.value) == f"The backup has no file {name}; it is incomplete."


@pytest.mark.parametrize("name", [DUMP_NAME, BLOB])
@pytest.mark.parametrize("change", [b"", b"altered"])
def test_a_member_that_was_altered_is_named_with_both_digests(backup: Path, name: str, change: bytes) -> None:
    with tarfile.open(backup) as tar:
        before = digest(tar.extractfile(name).read())  # type: ignore[union-attr]
    rewrite(backup, lambda members: members.update({name: change}))
    with BackupReader.opened(backup) as reader, pytest.raises(BackupRejected) as refused:
        reader.check()
    assert str(refused.value) == f"{name} was altered: expected SHA-256 {before}, got {digest(change)}."


def test_a_folder_in_place_of_a_member_is_none(backup: Path) -> None:
    rewrite(backup, lambda members: members.pop(DUMP_NAME))
    with tarfile.open(backup, "a:") as tar:
        folder = tarfile.TarInfo(DUMP_NAME)
        folder.type = tarfile.DIRTYPE
        tar.addfile(folder)
    with BackupReader.opened(backup) as reader, pytest.raises(BackupRejected, match=r"has no file database\.dump"):
        reader.check()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{}",
        b"not json",
        b"[]",
        description().model_dump_json().replace('"release"', '"version"').encode(),
    ],
)
def test_a_description_of_another_form_is_refused(backup: Path, content: bytes) -> None:
    rewrite(backup, lambda members: members.update({DESCRIPTION_NAME: content}))
    with (
        pytest.raises(BackupRejected, match=r"^backup\.json( cannot be read)?: ") as caught,
        BackupReader.opened(backup),
    ):
        pass
    assert "pydantic" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_backup_of_a_newer_release_names_it(backup: Path) -> None:
    newer = json.loads(description().model_dump_json()) | {"format": 2, "release": "9.1", "keys": ["added"]}
    rewrite(backup, lambda members: members.update({DESCRIPTION_NAME: json.dumps(newer).encode()}))
    said = r"^This backup has format 2, written by release 9\.1; this release reads format 1\. Restore it with that"
    with pytest.raises(BackupRejected, match=said), BackupReader.opened(backup):
        pass


def test_a_tar_file_without_a_description_is_no_backup(backup: Path) -> None:
    rewrite(backup, lambda members: members.pop(DESCRIPTION_NAME))
    with pytest.raises(BackupRejected, match=r"^The backup has no file backup\.json"), BackupReader.opened(backup):
        pass


@pytest.mark.parametrize("content", [b"", b"short", b"x" * 5000, bytes(300)])
def test_another_file_is_no_backup(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(BackupRejected), BackupReader.opened(path):
        pass


@pytest.mark.parametrize("part", [0.2, 0.6, 0.95])
def test_a_backup_that_was_cut_off_is_refused(backup: Path, part: float) -> None:
    content = backup.read_bytes()
    backup.write_bytes(content[: int(len(content) * part)])
    with pytest.raises(BackupRejected), BackupReader.opened(backup) as reader:
        reader.check()


def test_a_compressed_backup_is_refused_with_what_is_expected(backup: Path, tmp_path: Path) -> None:
    packed = tmp_path / "backup.tar.gz"
    with tarfile.open(packed, "w:gz") as tar:
        tar.add(backup)
    with pytest.raises(BackupRejected, match="Expected a file of `vitac admin backup`"), BackupReader.opened(packed):
        pass
