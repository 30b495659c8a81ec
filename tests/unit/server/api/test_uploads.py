import base64
import hashlib
import os
import socket
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any
from uuid import UUID

import psycopg
import pytest
from database_work import is_waiting_for_a_lock
from httpx import Response
from service_client import API, Service, bearer, make_archive, problem_of, running_service
from sqlalchemy import text, update
from sqlalchemy.exc import OperationalError
from vitac.server.database.engine import Database
from vitac.server.database.models import PartialUpload
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.submissions import partial_uploads
from vitac.server.submissions.pieces import PART_BYTES
from worker_fakes import eventually

from competitions import FIRST, SECOND, make_competition, put_in_place

TUS = {"Tus-Resumable": "1.0.0"}
PIECE = {"Content-Type": "application/offset+octet-stream"}


@pytest.fixture
def service(database: Database, tmp_path: Path) -> Iterator[Service]:
    with running_service(database, tmp_path, unfinished_uploads=2) as service:
        yield service


def encoded(**metadata: str) -> str:
    return ",".join(f"{name} {base64.b64encode(value.encode()).decode()}" for name, value in metadata.items())


def ask(service: Service, method: str, path: str, token: str | None = None, **options: Any) -> Response:
    headers = bearer(token or service.token) | TUS | options.pop("headers", {})
    return service.client.request(method, path, headers=headers, **options)


def begin(service: Service, length: int, token: str | None = None, **metadata: str) -> Response:
    headers = {"Upload-Length": str(length)} | ({"Upload-Metadata": encoded(**metadata)} if metadata else {})
    return ask(service, "POST", f"{API}/uploads", token, headers=headers)


def begun(service: Service, length: int, **metadata: str) -> str:
    answer = begin(service, length, **metadata)
    assert answer.status_code == 201, answer.text
    assert answer.headers["tus-resumable"] == "1.0.0"
    return answer.headers["location"]


def send(service: Service, place: str, offset: int, content: bytes, **headers: str) -> Response:
    given = PIECE | {"Upload-Offset": str(offset)} | {name.replace("_", "-"): value for name, value in headers.items()}
    return ask(service, "PATCH", place, headers=given, content=content)


def offset_of(service: Service, place: str) -> int:
    answer = ask(service, "HEAD", place)
    assert (answer.status_code, answer.headers["cache-control"]) == (200, "no-store")
    return int(answer.headers["upload-offset"])


def stored_parts(service: Service) -> list[Path]:
    return [path for path in service.settings.state_dir.glob("blobs/partial/**/*") if path.is_file()]


def big_archive() -> bytes:
    files = {
        "submission.yaml": "track: track_1\ntasks: [peg-insertion]\nname: big\n",
        "policy.py": "class Policy: ...\n",
    }
    return make_archive({f"Track_1/{name}": text for name, text in files.items()} | {"Track_1/w": os.urandom(3 << 20)})


def test_options_say_what_is_possible(service: Service) -> None:
    answer = service.client.options(f"{API}/uploads")
    assert answer.status_code == 204
    assert answer.headers["tus-extension"] == "creation,termination,expiration,checksum"
    assert answer.headers["tus-max-size"] == str(service.settings.limits.image_bytes)
    assert (answer.headers["tus-version"], answer.headers["tus-checksum-algorithm"]) == ("1.0.0", "sha256,sha1")


def test_pieces_of_any_length_become_the_submission_of_the_whole(service: Service) -> None:
    archive = big_archive()
    place = begun(service, len(archive), sha256=hashlib.sha256(archive).hexdigest(), track="track_1", filename="x.zip")
    offset = 0
    for length in (1, 1000, 1 << 20, len(archive)):
        answer = send(service, place, offset, archive[offset : offset + length])
        assert answer.status_code == 204, answer.text
        offset = int(answer.headers["upload-offset"])
        assert offset_of(service, place) == offset
    assert offset == len(archive)
    answer = service.post(f"{place.removeprefix(API)}/submission")
    assert answer.status_code == 202, answer.text
    submission = answer.json()
    assert answer.headers["location"] == f"{API}/submissions/{submission['id']}"
    assert submission["archive_sha256"] == hashlib.sha256(archive).hexdigest()
    assert stored_parts(service) == list(service.settings.scratch_dir.iterdir()) == []
    again = service.post(f"{place.removeprefix(API)}/submission")
    assert (again.status_code, again.json()["id"]) == (200, submission["id"])
    assert problem_of(send(service, place, offset, b"more"), 413, "upload_too_large")


def test_the_same_submission_asked_for_twice_at_once_is_made_once(service: Service) -> None:
    archive = big_archive()
    place = begun(service, len(archive))
    send(service, place, 0, archive)
    answers: list[Response] = []

    def complete() -> None:
        answers.append(service.post(f"{place.removeprefix(API)}/submission"))

    threads = [threading.Thread(target=complete) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    codes = [answer.status_code for answer in answers]
    # A team has so many uploads checked at the same time; the others may ask again.
    assert codes.count(202) == 1, [one.text for one in answers]
    assert set(codes) <= {200, 202, 429}, [one.text for one in answers]
    answers.append(service.post(f"{place.removeprefix(API)}/submission"))
    assert answers[-1].status_code == 200
    assert len({answer.json()["id"] for answer in answers if answer.status_code != 429}) == 1


def test_submission_and_its_upload_are_noted_together_or_not_at_all(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = big_archive()
    place = begun(service, len(archive))
    send(service, place, 0, archive)

    def fail(*_: object) -> None:
        raise OperationalError("UPDATE", {}, psycopg.OperationalError("the connection is cut between the two"))

    with monkeypatch.context() as patch:
        patch.setattr(partial_uploads, "finish", fail)
        assert service.post(f"{place.removeprefix(API)}/submission").status_code == 503
    with service.database.transaction() as session:
        assert session.scalar(text("SELECT count(*) FROM submissions")) == 0
    assert service.post(f"{place.removeprefix(API)}/submission").status_code == 202


def test_parts_that_cannot_be_removed_do_not_refuse_the_submission(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = big_archive()
    place = begun(service, len(archive))
    send(service, place, 0, archive)

    def fail(*_: object) -> None:
        raise ServiceError(ProblemCode.STORAGE_UNAVAILABLE, "The bucket is away.")

    with monkeypatch.context() as patch:
        patch.setattr(type(service.services.blobs), "delete_parts", fail)
        assert service.post(f"{place.removeprefix(API)}/submission").status_code == 202
    with service.database.transaction() as session:
        session.execute(update(PartialUpload).values(expires_at=datetime.now(UTC)))
    partial_uploads.remove_expired(service.services)
    assert stored_parts(service) == []


def test_an_upload_that_is_removed_while_it_is_put_together_is_not_found(service: Service, tmp_path: Path) -> None:
    archive = big_archive()
    place = begun(service, len(archive))
    send(service, place, 0, archive)
    upload_id = UUID(place.rsplit("/", 1)[-1])
    partial_uploads.remove(service.services, upload_id)
    with pytest.raises(ServiceError, match="no upload") as refused:
        partial_uploads.put_together(service.services, upload_id, tmp_path)
    assert refused.value.code is ProblemCode.NOT_FOUND
    with service.database.transaction() as session, pytest.raises(ServiceError, match="no upload"):
        partial_uploads.lock(session, upload_id)


def test_an_upload_that_goes_on_while_expired_ones_are_removed_stays(service: Service) -> None:
    place = begun(service, 10)
    send(service, place, 0, b"12345")
    with service.database.transaction() as session:
        session.execute(update(PartialUpload).values(expires_at=datetime.now(UTC)))
    removing = threading.Thread(target=partial_uploads.remove_expired, args=(service.services,))
    with service.database.transaction() as session:
        # A piece that is being counted: the removal waits for it and then finds the upload alive.
        session.execute(update(PartialUpload).values(expires_at=datetime.now(UTC) + timedelta(hours=1)))
        removing.start()
        eventually(lambda: is_waiting_for_a_lock(service.database))
    removing.join()
    assert offset_of(service, place) == 5
    assert len(stored_parts(service)) == 1


def test_what_came_before_a_cut_counts(service: Service) -> None:
    archive = big_archive()
    place = begun(service, len(archive))
    head = (
        f"PATCH {place} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {service.token}\r\nTus-Resumable: 1.0.0\r\n"
        f"Content-Type: {PIECE['Content-Type']}\r\nUpload-Offset: 0\r\nContent-Length: {len(archive)}\r\n\r\n"
    )
    with socket.create_connection(service.address) as connection:
        connection.sendall(head.encode() + archive[:100_000])
    eventually(lambda: offset_of(service, place) == 100_000)
    assert send(service, place, 100_000, archive[100_000:]).status_code == 204
    assert service.post(f"{place.removeprefix(API)}/submission").status_code == 202


def test_a_piece_is_announced_as_one_fits_whole_and_goes_on_where_the_last_one_ended(service: Service) -> None:
    place = begun(service, 100)
    answer = ask(service, "PATCH", place, headers={"Upload-Offset": "0", "Content-Type": "text/plain"}, content=b"x")
    problem_of(answer, 415, "unsupported_content_type")
    problem_of(ask(service, "PATCH", place, headers=PIECE, content=b"x"), 400, "length_invalid")
    problem_of(send(service, place, 0, b"x" * 101), 413, "upload_too_large")
    assert offset_of(service, place) == 0
    assert send(service, place, 0, b"x" * 10).status_code == 204
    for offset in (0, 11, 100):
        assert problem_of(send(service, place, offset, b"y"), 409, "upload_conflict")["offset"] == 10
    assert offset_of(service, place) == 10


def test_of_two_clients_that_send_the_same_piece_one_goes_on(service: Service) -> None:
    length = 2 * PART_BYTES
    place, content = begun(service, length), os.urandom(length)
    statuses: list[int] = []
    threads = [
        threading.Thread(target=lambda: statuses.append(send(service, place, 0, content).status_code)) for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert statuses.count(204) <= 1
    assert set(statuses) <= {204, 409}
    offset = offset_of(service, place)
    if offset < length:
        assert send(service, place, offset, content[offset:]).status_code == 204
    with service.database.transaction() as session:
        upload = session.query(PartialUpload).one()
    folder = service.settings.scratch_dir
    assert (
        partial_uploads.put_together(service.services, upload.id, folder).sha256 == hashlib.sha256(content).hexdigest()
    )
    assert sum(path.stat().st_size for path in stored_parts(service)) == length


@pytest.mark.parametrize("algorithm", ["sha256", "sha1"])
def test_a_piece_with_a_checksum_counts_whole_or_not_at_all(service: Service, algorithm: str) -> None:
    content = os.urandom(PART_BYTES + 1000)
    place = begun(service, len(content))
    digest = base64.b64encode(hashlib.new(algorithm, content).digest()).decode()
    damaged = content[:-1] + bytes([content[-1] ^ 1])
    answer = send(service, place, 0, damaged, Upload_Checksum=f"{algorithm} {digest}")
    problem_of(answer, 460, "checksum_mismatch")
    assert (offset_of(service, place), stored_parts(service)) == (0, [])
    assert send(service, place, 0, content, Upload_Checksum=f"{algorithm} {digest}").status_code == 204
    assert offset_of(service, place) == len(content)


def test_an_upload_is_a_submission_with_its_last_byte_and_only_if_it_is_whole_and_breaks_no_rule(
    service: Service,
) -> None:
    archive = make_archive()
    damaged = begun(service, len(archive), sha256="0" * 64)
    send(service, damaged, 0, archive)
    problem_of(service.post(f"{damaged.removeprefix(API)}/submission"), 400, "digest_mismatch")
    assert ask(service, "HEAD", damaged).status_code == 404
    assert stored_parts(service) == []
    place = begun(service, 5)
    send(service, place, 0, b"nozip")
    problem_of(service.post(f"{place.removeprefix(API)}/submission"), 422, "archive_rejected")
    assert service.leftovers() == []
    place = begun(service, len(archive))
    send(service, place, 0, archive[:-1])
    problem = problem_of(service.post(f"{place.removeprefix(API)}/submission"), 409, "upload_incomplete")
    assert problem["offset"] == len(archive) - 1
    send(service, place, len(archive) - 1, archive[-1:])
    assert service.post(f"{place.removeprefix(API)}/submission").status_code == 202


def competition_that_closed(service: Service, *, before_the_bytes: timedelta) -> str:
    """An upload whose bytes are there, to a stage that has closed meanwhile and that another one follows."""
    archive = make_archive()
    place = begun(service, len(archive))
    assert send(service, place, 0, archive).status_code == 204
    content, now = make_competition(), datetime.now(UTC)
    first, second = content["tracks"]["track_1"]["stages"]
    first |= {"opens": (now - timedelta(days=3)).isoformat(), "closes": (now - before_the_bytes).isoformat()}
    second |= {"opens": now.isoformat(), "closes": (now + timedelta(days=1)).isoformat(), "qualified": None}
    with service.database.transaction() as session:
        put_in_place(session, content)
        session.execute(update(PartialUpload).values(completed_at=now - timedelta(hours=1)))
    return f"{place.removeprefix(API)}/submission"


def test_an_upload_is_in_time_where_its_last_byte_was(service: Service) -> None:
    in_time = competition_that_closed(service, before_the_bytes=timedelta(minutes=30))
    answer = service.post(in_time)
    assert (answer.status_code, answer.json()["stage"]) == (202, FIRST)


def test_an_upload_after_a_stage_belongs_to_the_one_that_is_open(service: Service) -> None:
    late = competition_that_closed(service, before_the_bytes=timedelta(hours=2))
    assert service.post(late).json()["stage"] == SECOND


def test_the_same_content_is_continued_by_whoever_has_the_teams_token(service: Service) -> None:
    archive = make_archive()
    digest = hashlib.sha256(archive).hexdigest()
    place = begun(service, len(archive), sha256=digest)
    send(service, place, 0, archive[:100])
    answer = begin(service, len(archive), sha256=digest)
    assert (answer.headers["location"], answer.headers["upload-offset"]) == (place, "100")
    assert begin(service, len(archive), service.other_token, sha256=digest).headers["location"] != place
    assert begin(service, len(archive), sha256=digest, again="true").headers["location"] != place


def test_a_team_has_so_many_unfinished_uploads_also_when_it_begins_many_at_once(service: Service) -> None:
    answers: list[Response] = []
    threads = [threading.Thread(target=lambda: answers.append(begin(service, 10))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answer.status_code for answer in answers) == [201, 201] + 6 * [429]
    assert begin(service, 10, service.other_token).status_code == 201
    made = next(answer for answer in answers if answer.status_code == 201)
    assert ask(service, "DELETE", made.headers["location"]).status_code == 204
    assert begin(service, 10).status_code == 201


def test_a_body_at_once_is_an_upload_that_is_gone_with_the_answer(service: Service) -> None:
    for _ in range(2):
        begun(service, 5)  # the most unfinished ones of a team, which hold up no body that arrives at once
    assert service.upload(make_archive()).status_code == 202
    problem_of(service.upload(b"no archive"), 422, "archive_rejected")
    assert service.count("partial_uploads") == 2


def test_a_deleted_upload_is_gone_with_its_parts(service: Service) -> None:
    place = begun(service, 10)
    send(service, place, 0, b"x")
    assert len(stored_parts(service)) == 1
    assert ask(service, "DELETE", place).status_code == 204
    assert [ask(service, method, place).status_code for method in ("HEAD", "DELETE")] == [404, 404]
    assert send(service, place, 1, b"y").status_code == 404
    assert stored_parts(service) == []


def test_an_organizer_uploads_for_a_team(service: Service) -> None:
    archive = make_archive()
    assert begin(service, len(archive), service.organizer_token).status_code == 422
    answer = begin(service, len(archive), service.organizer_token, team="Team B")
    place = answer.headers["location"]
    headers = PIECE | {"Upload-Offset": "0"}
    ask(service, "PATCH", place, service.organizer_token, headers=headers, content=archive)
    made = service.post(f"{place.removeprefix(API)}/submission", service.organizer_token)
    assert made.json()["team"]["name"] == "Team B"


def test_a_head_that_cannot_be_used_is_refused_by_name(service: Service) -> None:
    for length, metadata, status, code in [
        ("", "", 400, "length_invalid"),
        ("-1", "", 400, "length_invalid"),
        ("1_0", "", 400, "length_invalid"),
        ("9" * 30, "", 400, "length_invalid"),
        ("0", "", 400, "upload_truncated"),
        (str(1 << 40), "", 413, "upload_too_large"),
        ("5", "kind bm90aGluZw==", 422, "invalid_request"),
        ("5", "track dHJhY2tfOTk=", 404, "unknown_track"),
        ("5", "kind ?", 422, "invalid_request"),
        ("5", "kind /w==", 422, "invalid_request"),
        ("5", "team AA==", 422, "invalid_request"),
        ("5", "sha256 YWJj", 422, "invalid_request"),
        ("5", "again dHJ1ZQ==,again dHJ1ZQ==", 422, "invalid_request"),
    ]:
        headers = {"Upload-Length": length, "Upload-Metadata": metadata}
        problem_of(ask(service, "POST", f"{API}/uploads", headers=headers), status, code)


def test_an_abandoned_upload_expires_and_is_removed_with_its_parts(service: Service) -> None:
    place = begun(service, 10)
    answer = send(service, place, 0, b"x")
    expiry = parsedate_to_datetime(answer.headers["upload-expires"])
    assert timedelta(hours=23) < expiry - datetime.now(UTC) <= timedelta(hours=24)
    with service.database.transaction() as session:
        session.execute(update(PartialUpload).values(expires_at=datetime.now(UTC)))
    assert ask(service, "HEAD", place).status_code == 404
    assert send(service, place, 1, b"x").status_code == 404
    partial_uploads.remove_expired(service.services)
    assert stored_parts(service) == []
    with service.database.transaction() as session:
        assert session.scalar(text("SELECT count(*) FROM partial_uploads")) == 0


def test_parts_that_no_upload_has_are_removed_once_they_are_old(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun(service, 10)
    service.services.blobs.put_part("00000000-0000-0000-0000-000000000000", "1", b"x")
    partial_uploads.remove_expired(service.services)
    assert len(stored_parts(service)) == 1
    monkeypatch.setattr(partial_uploads, "timedelta", lambda **_: timedelta(0))
    partial_uploads.remove_expired(service.services)
    assert stored_parts(service) == []


def test_a_store_that_does_not_work_loses_nothing_that_counted(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = begun(service, 10)
    send(service, place, 0, b"12345")

    def full(*_: object) -> str:
        raise ServiceError(ProblemCode.STORAGE_UNAVAILABLE, "The disk is full.")

    with monkeypatch.context() as patch:
        patch.setattr(type(service.services.blobs), "put_part", full)
        problem_of(send(service, place, 5, b"678"), 503, "storage_unavailable")
    assert offset_of(service, place) == 5
    assert send(service, place, 5, b"67890").status_code == 204


def test_an_upload_of_too_many_pieces_is_refused(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(partial_uploads, "MAX_PARTS", 3)
    place = begun(service, 10)
    assert [send(service, place, offset, b"x").status_code for offset in range(4)] == [204, 204, 204, 429]
    assert (offset_of(service, place), len(stored_parts(service))) == (3, 3)


def test_the_name_of_a_file_is_compared_when_all_of_it_is_there(service: Service) -> None:
    body = make_archive()
    early = begin(service, len(body), filename="Team B-Track_1-stage1-result.zip")
    problem_of(early, 422, "file_name_mismatch")
    for name, status in (("Team A-Track_3-stage1-result.zip", 422), ("Team A-Track_1-stage1-result.zip", 202)):
        place = begun(service, len(body), filename=name)
        assert send(service, place, 0, body).status_code == 204
        assert ask(service, "POST", f"{place}/submission").status_code == status
    assert len(service.get("/submissions").json()["items"]) == 1
