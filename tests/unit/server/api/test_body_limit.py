import os
from collections.abc import Iterator

import pytest
from service_client import Service, bearer, make_archive, problem_of
from vitac.server.api.body_limit import LIMIT_BYTES


@pytest.mark.parametrize("path", ["/api/v1/teams", "/api/v1/tokens"])
def test_large_json_is_refused_whether_its_length_is_told_or_not(service: Service, path: str) -> None:
    body = b'{"name": "' + b"x" * LIMIT_BYTES + b'"}'

    def chunks() -> Iterator[bytes]:
        yield from (body[start : start + 1000] for start in range(0, len(body), 1000))

    headers = {"Content-Type": "application/json"} | bearer(service.token)
    for content in (body, chunks()):
        answer = service.client.post(path, content=content, headers=headers)
        problem_of(answer, 413, "body_too_large")
    assert service.client.get("/health").status_code == 200


def test_body_at_the_limit_is_read(service: Service) -> None:
    body = b'{"name": "fits"' + b" " * (LIMIT_BYTES - 16) + b"}"
    assert len(body) == LIMIT_BYTES
    answer = service.client.post("/api/v1/teams", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 201


def test_uploads_have_their_own_limit(service: Service) -> None:
    archive = make_archive({"Track_1/weights": os.urandom(2 * LIMIT_BYTES)})
    problem_of(service.upload(archive), 422, "manifest_rejected")
