import hashlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from httpx import Response
from service_client import API, Service, bearer, make_archive, problem_of, running_service
from vitac.server.api.streams import OpenStreams
from vitac.server.database.engine import Database
from vitac.server.settings import Quotas

pytestmark = pytest.mark.usefixtures("quota_clock")


@pytest.fixture
def service(database: Database, tmp_path: Path) -> Iterator[Service]:
    quotas = Quotas(attempts_per_day=1, tokens=3, event_streams=1)
    with running_service(database, tmp_path, quotas=quotas, uploads_at_once=50) as service:
        yield service


def at_once(requests: list[Callable[[], Response]]) -> list[Response]:
    answers: list[Response] = []
    threads = [threading.Thread(target=_keep, args=[answers, send]) for send in requests]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answers


def _keep(answers: list[Response], send: Callable[[], Response]) -> None:
    answers.append(send())


def archive(number: int) -> bytes:
    return make_archive(policy=f"class Policy: ...  # {number}\n")


def test_of_twenty_posts_at_once_over_a_quota_of_one_exactly_one_is_taken(service: Service) -> None:
    bodies = [archive(number) for number in range(20)]
    answers = at_once([partial(service.upload, body) for body in bodies])
    assert sorted(answer.status_code for answer in answers) == [202] + 19 * [429]
    problem = problem_of(next(answer for answer in answers if answer.status_code == 429), 429, "quota_exceeded")
    assert problem["quota"] == "attempts_per_day"


def test_a_daily_refusal_says_in_its_header_when_to_come_back(service: Service) -> None:
    service.upload(archive(1))
    answer = service.upload(archive(2))
    assert 0 < int(answer.headers["retry-after"]) <= 24 * 3600


def test_a_used_quota_is_refused_before_a_body_whose_digest_is_told(service: Service) -> None:
    body = archive(1)
    done = service.upload(body)
    assert service.upload(body, X_Content_SHA256=done.json()["archive_sha256"]).status_code == 200
    problem_of(service.upload(b"never read as a zip", X_Content_SHA256="0" * 64), 429, "quota_exceeded")
    headers = bearer(service.token) | {"Tus-Resumable": "1.0.0", "Upload-Length": "5"}
    problem_of(service.client.post(f"{API}/uploads", headers=headers), 429, "quota_exceeded")


def test_of_tokens_made_at_once_no_more_than_the_quota_are_good(service: Service) -> None:
    answers = at_once([lambda: service.post("/tokens", json={"label": "x"}) for _ in range(8)])
    assert sorted(answer.status_code for answer in answers) == [201, 201] + 6 * [429]
    made = next(answer for answer in answers if answer.status_code == 201).json()["id"]
    service.client.delete(f"{API}/tokens/{made}", headers=bearer(service.token))
    assert service.post("/tokens", json={"label": "x"}).status_code == 201
    assert service.post("/tokens", service.organizer_token, json={"label": "x"}).status_code == 201


def test_a_team_has_so_many_event_streams_and_other_teams_theirs(service: Service) -> None:
    def streaming(token: str) -> str:
        return f"/submissions/{service.upload(archive(1), token).json()['id']}/events"

    mine, other = streaming(service.token), streaming(service.other_token)
    with service.client.stream("GET", f"{API}{mine}", headers=bearer(service.token)) as first:
        lines = first.iter_lines()  # kept: the stream is closed with it
        assert next(lines)
        problem_of(service.get(mine), 429, "quota_exceeded")
        with service.client.stream("GET", f"{API}{other}", headers=bearer(service.other_token)) as theirs:
            assert theirs.status_code == 200


def test_an_upload_that_is_refused_after_it_was_stored_leaves_nothing(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, quotas=Quotas(stored_mib=1)) as service:
        problem_of(service.upload(archive(1)), 429, "quota_exceeded")
        assert not service.services.blobs.holds(hashlib.sha256(archive(1)).hexdigest())


def test_of_two_streams_asked_for_at_once_the_one_too_many_is_refused(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = f"/submissions/{service.upload(archive(1)).json()['id']}/events"
    both_look, both_asked, answers = threading.Barrier(2), threading.Barrier(2), list[int]()

    def find_limit(*_: object) -> int:
        both_look.wait(60)
        return 1

    def follow() -> None:
        with service.client.stream("GET", f"{API}{path}", headers=bearer(service.token)) as answer:
            answers.append(answer.status_code)
            both_asked.wait(60)

    monkeypatch.setattr(OpenStreams, "_find_limit", find_limit)
    threads = [threading.Thread(target=follow) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [200, 429]


def test_a_team_reads_its_quotas_and_an_organizer_has_none(service: Service) -> None:
    service.upload(archive(1))
    shown = {quota["quota"]: quota for quota in service.get("/me").json()["quotas"]}
    attempts = shown["attempts_per_day"]
    assert (attempts["limit"], attempts["used"], shown["scored_runs_per_day"]["limit"]) == (1, 1, None)
    assert attempts["opens_at"].endswith("T00:00:00Z")
    assert shown["tokens"]["used"] == 1
    assert service.get("/me", service.organizer_token).json()["quotas"] == []
