import base64
import hashlib
import json
import socket
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from service_client import MANIFEST, POLICY, Service, bearer, make_archive, problem_of, running_service
from service_factories import TASK, TRACK, make_record, play_all
from sqlalchemy import text, update
from structlog.testing import capture_logs
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import cut
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Submission
from vitac.server.submissions import listing
from worker_fakes import eventually

ARCHIVE = make_archive()


def submission_of(service: Service, identity: str) -> Submission:
    with service.database.transaction() as session:
        return session.get_one(Submission, identity)


def test_upload_is_accepted_with_an_id_a_position_and_jobs(service: Service) -> None:
    answer = service.upload(ARCHIVE)
    assert answer.status_code == 202, answer.text
    body = answer.json()
    assert answer.headers["location"] == f"/api/v1/submissions/{body['id']}"
    assert (body["track"], body["tasks"], body["name"], body["team"]["name"]) == (TRACK, [TASK], "zero", "Team A")
    assert (body["evaluation"]["state"], body["evaluation"]["queue_position"]) == ("queued", 1)
    assert body["archive_sha256"] == hashlib.sha256(ARCHIVE).hexdigest()
    assert service.get(f"/submissions/{body['id']}").json() == body
    assert service.count("work") == len(cut(load_track(TRACK).tasks[TASK]))
    assert service.services.blobs.holds(body["archive_sha256"])
    assert list(service.settings.scratch_dir.iterdir()) == []


def test_same_content_packed_differently_is_answered_with_the_submission_that_exists(service: Service) -> None:
    first = service.upload(ARCHIVE)
    other_zip = make_archive({"Track_1/policy.py": POLICY, "Track_1/submission.yaml": MANIFEST})
    assert other_zip != ARCHIVE
    again = service.upload(other_zip)
    assert (again.status_code, again.json()["id"]) == (200, first.json()["id"])
    assert service.count("evaluations") == 1
    stored = [service.services.blobs.holds(hashlib.sha256(one).hexdigest()) for one in (ARCHIVE, other_zip)]
    assert stored == [True, False], "nobody needs the second one"


@pytest.mark.parametrize("days", [0, 2])
def test_a_cancelled_submission_is_taken_up_by_its_content_packed_differently(service: Service, days: int) -> None:
    packed = ARCHIVE, make_archive({"Track_1/policy.py": POLICY, "Track_1/submission.yaml": MANIFEST})
    first, other = (hashlib.sha256(one).hexdigest() for one in packed)
    identity = service.upload(ARCHIVE).json()["id"]
    service.post(f"/submissions/{identity}/cancel")
    with service.database.transaction() as session:
        session.execute(update(Evaluation).values(finished_at=datetime.now(UTC) - timedelta(days=days)))
    answer = service.upload(packed[1])
    assert (answer.status_code, answer.json()["id"]) == (202, identity)
    gone = days > 1  # the first archive is, or will be soon
    assert submission_of(service, identity).archive_sha256 == (other if gone else first)
    assert service.services.blobs.holds(other) is gone


def test_same_upload_at_the_same_time_is_one_submission(service: Service) -> None:
    answers = []
    threads = [threading.Thread(target=lambda: answers.append(service.upload(ARCHIVE))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answer.status_code for answer in answers) == [200, 202]
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert service.count("submissions") == service.count("evaluations") == 1


def test_completed_submission_shows_score_interval_shapes_and_rank_ends_its_events_and_runs_again(
    service: Service,
) -> None:
    identity = service.upload(ARCHIVE).json()["id"]
    play_all(service.database, submission_of(service, identity))
    body = service.get(f"/submissions/{identity}").json()
    assert body["evaluation"]["state"] == "completed"
    assert body["rank"] == {"rank": 1, "of": 1}
    score = body["evaluation"]["scores"][0]
    assert score["success_rate"] == 1.0
    assert score["success_rate_interval"][1] == 1.0
    assert [shape["episodes"] for shape in score["shapes"]] == [90, 90, 90]
    assert score["result_hash"] == body["evaluation"]["result_hash"]
    episodes = service.get(f"/submissions/{identity}/episodes").json()
    assert len(episodes) == 270
    assert episodes[0].pop("initial_offset") == [-4.0, -4.0, -8.0]
    assert score["starts"] == len({(one["shape"], *one.get("initial_offset", ())) for one in episodes[1:]}) == 90
    assert episodes[0] == {
        "task": TASK,
        "episode": 1,
        "shape": episodes[0]["shape"],
        "outcome": "success",
        "success": True,
        "env_steps": 3,
        "forces": None,
        "draws": {},
    }
    path = f"/api/v1/submissions/{identity}/events"
    with service.client.stream("GET", path, headers=bearer(service.token)) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        lines = [line for line in answer.iter_lines() if line]
    assert [line for line in lines if line.startswith("event: ")] == ["event: submission", "event: end"]
    data = next(line.removeprefix("data: ") for line in lines if line.startswith("data: "))
    assert json.loads(data)["evaluation"]["state"] == "completed"
    assert service.upload(ARCHIVE).status_code == 200
    again = service.upload(ARCHIVE, query="?again=true")
    assert (again.status_code, again.json()["evaluation"]["run"]) == (202, 2)


def test_no_or_unknown_token_is_refused_before_the_body_is_read(service: Service) -> None:
    for headers, code in [
        ({}, "missing_credentials"),
        ({"Authorization": "Basic dGVzdDp0ZXN0"}, "missing_credentials"),
        (bearer("vitac_short"), "invalid_credentials"),
        (bearer("vitac_" + "A" * 43), "invalid_credentials"),
    ]:
        answer = service.client.post("/api/v1/submissions", content=ARCHIVE, headers=headers)
        problem_of(answer, 401, code)
        assert answer.headers["www-authenticate"] == "Bearer"
        service.assert_nothing_left()


def test_an_organizer_disqualifies_a_submission_and_its_team_reads_why(service: Service) -> None:
    path = f"/submissions/{service.upload(ARCHIVE).json()['id']}"
    address, body = f"/api/v1{path}/disqualification", {"reason": "trained on the list"}
    problem_of(service.client.put(address, json=body, headers=bearer(service.token)), 403, "forbidden")
    organizer = bearer(service.organizer_token)
    done = service.client.put(address, json=body, headers=organizer)
    assert (done.status_code, done.json()["disqualified_for"]) == (200, "trained on the list")
    assert service.get(path).json()["disqualified_for"] == "trained on the list"
    problem_of(service.upload(ARCHIVE), 403, "submission_disqualified")
    again = service.client.delete(address, headers=organizer)
    assert (again.status_code, again.json()["disqualified_for"]) == (200, None)


def test_lists_are_separate_for_teams_and_whole_for_organizers(service: Service) -> None:
    mine = service.upload(ARCHIVE).json()["id"]
    theirs = service.upload(ARCHIVE, service.other_token).json()["id"]
    assert [item["id"] for item in service.get("/submissions").json()["items"]] == [mine]
    everything = service.get("/submissions?limit=1", service.organizer_token).json()
    assert [item["id"] for item in everything["items"]] == [theirs]
    rest = service.get(f"/submissions?before={everything['next_before']}", service.organizer_token).json()
    assert ([item["id"] for item in rest["items"]], rest["next_before"]) == ([mine], None)


def test_organizer_uploads_for_a_named_team(service: Service) -> None:
    problem_of(service.upload(ARCHIVE, service.organizer_token), 422, "team_required")
    problem_of(service.upload(ARCHIVE, service.organizer_token, "?team=nobody"), 404, "unknown_team")
    answer = service.upload(ARCHIVE, service.organizer_token, "?team=team%20a")
    assert answer.json()["team"]["name"] == "Team A"


def test_cancel_ends_the_evaluation_once(service: Service) -> None:
    identity = service.upload(ARCHIVE).json()["id"]
    answer = service.post(f"/submissions/{identity}/cancel")
    assert (answer.status_code, answer.json()["evaluation"]["state"]) == (200, "cancelled")
    problem = problem_of(service.post(f"/submissions/{identity}/cancel"), 409, "not_cancellable")
    assert problem["state"] == "cancelled"


def test_other_content_types_are_refused_and_ours_may_have_parameters_and_capitals(service: Service) -> None:
    for content_type in ["", "text/plain", "multipart/form-data; boundary=x", "application/gzip"]:
        problem = problem_of(service.upload(ARCHIVE, Content_Type=content_type), 415, "unsupported_content_type")
        assert problem["supported"] == ["application/zip"]
        service.assert_nothing_left()
    assert service.upload(ARCHIVE, Content_Type="Application/ZIP; q=1").status_code == 202


def test_unknown_track_is_refused_with_the_list_of_tracks(service: Service) -> None:
    for query in ["?track=track_9", "?track=../../etc/passwd", "?track="]:
        problem = problem_of(service.upload(ARCHIVE, query=query), 404, "unknown_track")
        assert TRACK in problem["tracks"]
        service.assert_nothing_left()


def test_digest_that_came_along_is_verified(service: Service) -> None:
    digest = hashlib.sha256(ARCHIVE)
    good = f"sha-512=:AAAA:, sha-256=:{base64.b64encode(digest.digest()).decode()}:"
    problem_of(service.upload(ARCHIVE, X_Content_SHA256="0" * 64), 400, "digest_mismatch")
    for value in ("sha-256=:AAAA:", "sha-256=:?:"):
        problem_of(service.upload(ARCHIVE, Content_Digest=value), 422, "invalid_request")
    service.assert_nothing_left()
    assert service.upload(ARCHIVE, X_Content_SHA256=digest.hexdigest().upper()).status_code == 202
    assert service.upload(ARCHIVE, Content_Digest=good).status_code == 200


def test_archive_that_breaks_a_rule_or_is_empty_is_refused_and_nothing_is_left(service: Service) -> None:
    rows: list[tuple[dict[str, str | bytes] | None, str]] = [
        ({"Track_1/../../escaped.py": "x"}, "parent_path"),
        ({"Other/submission.yaml": MANIFEST}, "wrong_top_folder"),
        ({"Track_1/submission.yaml": MANIFEST, "Track_1/bomb": b"\0" * (64 << 20)}, "compressed_too_much"),
        ({"Track_1/submission.yaml": MANIFEST, "Track_1/wheels/jax-0.9.tar.gz": b"x"}, "wheel"),
        (None, "not_a_zip"),
    ]
    for files, reason in rows:
        archive = b"\x89PNG not a zip" if files is None else make_archive(files)
        problem = problem_of(service.upload(archive), 422, "archive_rejected")
        assert problem["reason"] == reason
        service.assert_nothing_left()
    problem_of(service.upload(b""), 400, "upload_truncated")
    service.assert_nothing_left()


def test_size_limit_is_told_from_the_header_before_the_body_is_read_and_cuts_a_chunked_body(
    database: Database, tmp_path: Path
) -> None:
    with running_service(database, tmp_path, limits=Limits(archive_packed_bytes=1000)) as service:
        answer = talk(service, head(service, "Content-Length: 1001", "Expect: 100-continue"))
        assert answer.startswith("HTTP/1.1 413 ")
        assert "connection: close" in answer
        assert '"limit_bytes":1000' in answer
        problem_of(service.upload(iter([b"x" * 600] * 3)), 413, "upload_too_large")
        service.assert_nothing_left()


def test_client_that_waits_for_continue_is_told_to_go_on(service: Service) -> None:
    with socket.create_connection(service.address) as connection:
        connection.sendall(
            head(service, f"Content-Length: {len(ARCHIVE)}", "Expect: 100-continue", "Connection: close")
        )
        assert connection.recv(1000).startswith(b"HTTP/1.1 100 ")
        connection.sendall(ARCHIVE)
        assert read_all(connection).startswith("HTTP/1.1 202 ")


def test_connection_that_breaks_in_the_middle_leaves_nothing(service: Service) -> None:
    with socket.create_connection(service.address) as connection:
        connection.sendall(head(service, f"Content-Length: {len(ARCHIVE)}") + ARCHIVE[:100])
        eventually(lambda: service.count("partial_uploads") == 1)
    eventually(lambda: service.count("partial_uploads") == 0)
    service.assert_nothing_left()


def test_upload_that_sends_nothing_is_given_up(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, upload_idle_timeout_s=0.1) as service:
        answer = talk(service, head(service, f"Content-Length: {len(ARCHIVE)}") + ARCHIVE[:100])
        assert answer.startswith("HTTP/1.1 400 ")
        assert "upload_truncated" in answer
        service.assert_nothing_left()


def test_only_so_many_uploads_of_a_team_at_once(database: Database, tmp_path: Path) -> None:
    with (
        running_service(database, tmp_path, uploads_at_once=1) as service,
        socket.create_connection(service.address) as connection,
    ):
        connection.sendall(head(service, f"Content-Length: {len(ARCHIVE)}") + ARCHIVE[:100])
        eventually(lambda: service.count("partial_uploads") == 1)
        problem_of(service.upload(ARCHIVE), 429, "too_many_requests")
        assert service.upload(ARCHIVE, service.other_token).status_code == 202
        connection.sendall(ARCHIVE[100:])
        eventually(lambda: service.count("submissions") == 2)


def head(service: Service, *headers: str) -> bytes:
    lines = ("POST /api/v1/submissions HTTP/1.1", "Host: test", "Content-Type: application/zip", *headers)
    return "\r\n".join((*lines, f"Authorization: Bearer {service.token}", "", "")).encode()


def talk(service: Service, request: bytes) -> str:
    with socket.create_connection(service.address) as connection:
        connection.sendall(request)
        return read_all(connection)


def read_all(connection: socket.socket) -> str:
    connection.settimeout(60.0)
    received = b""
    while chunk := connection.recv(65536):
        received += chunk
    return received.decode()


def test_database_that_is_away_is_a_problem_with_retry_after(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listing, "list_submissions", lambda *_, **__: _lose_connection(service))
    answer = service.get("/submissions")
    problem_of(answer, 503, "database_unavailable")
    assert answer.headers["retry-after"] == "2"


def _lose_connection(service: Service) -> None:
    with service.database.transaction() as session:
        session.execute(text("SELECT pg_terminate_backend(pg_backend_pid())"))


def test_bug_is_a_problem_without_details(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listing, "list_submissions", lambda *_, **__: 1 / 0)
    with capture_logs() as events:
        problem = problem_of(service.get("/submissions"), 500, "internal_error")
    assert "zero" not in problem["detail"]
    assert [event["event"] for event in events if isinstance(event.get("exc_info"), ZeroDivisionError)] == [
        "request_failed"
    ]


def test_output_of_the_policy_is_read_page_by_page(service: Service) -> None:
    identity = service.upload(ARCHIVE).json()["id"]
    play_all(
        service.database,
        submission_of(service, identity),
        lambda episode, *, task: make_record(episode, task=task, output=f"in {episode}"),
    )
    path = f"/submissions/{identity}/output"
    assert [item["episode"] for item in service.get(path).json()["items"]] == list(range(1, 21))
    page = service.get(path, params={"task": TASK, "after": 3, "limit": 2}).json()
    assert [(item["episode"], item["output"]) for item in page["items"]] == [(4, "in 4"), (5, "in 5")]
    assert page["next_after"] == 5
    problem_of(service.get(path, params={"task": "none"}), 404, "unknown_task")
    assert service.get(path, params={"after": 2**31 - 1}).json() == {"items": [], "next_after": None}
    too_large = problem_of(service.get(path, params={"after": 2**31}), 422, "invalid_request")
    assert "after" in too_large["detail"]
    assert service.get(path, service.other_token).status_code == 404


def test_a_file_named_for_another_team_or_track_is_refused(service: Service) -> None:
    def uploaded(name: str) -> tuple[int, str | None]:
        answer = service.upload(make_archive(), query=f"?file_name={name}")
        return answer.status_code, answer.json().get("code")

    assert uploaded("Team B-Track_1-stage1-result.zip") == (422, "file_name_mismatch")
    assert uploaded("Team A-Track_2-stage1-result.zip") == (422, "file_name_mismatch")
    assert service.get("/submissions").json()["items"] == []
    assert uploaded("team_a-Track_1-stage1-result.zip") == (202, None)
