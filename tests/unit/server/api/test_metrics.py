import threading
from pathlib import Path

import pytest
from service_client import Service, bearer, problem_of, running_service
from vitac.server.database.engine import Database
from vitac.server.operations import exposition

TOKEN = "for-prometheus-only"  # noqa: S105 - of this test


def test_metrics_are_for_organizers(service: Service) -> None:
    tokens = {"team": service.token, "organizer": service.organizer_token, "made up": TOKEN}
    for who in ("nobody", "team", "made up", "organizer"):
        answer = service.client.get("/metrics", headers=bearer(tokens[who]) if who in tokens else {})
        if who == "organizer":
            assert answer.status_code == 200
            assert answer.headers["content-type"].startswith("text/plain")
            assert "vitac_shards{" in answer.text
        elif who == "team":
            problem_of(answer, 403, "forbidden")
        else:
            problem_of(answer, 401, "missing_credentials" if who == "nobody" else "invalid_credentials")


def test_token_of_the_settings_reads_metrics_and_nothing_else(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, metrics_token=TOKEN) as service:
        assert "vitac_database_up 1.0" in service.client.get("/metrics", headers=bearer(TOKEN)).text
        problem_of(service.client.get("/metrics", headers=bearer(TOKEN + "x")), 401, "invalid_credentials")
        problem_of(service.client.get("/metrics"), 401, "missing_credentials")
        problem_of(service.get("/submissions", TOKEN), 401, "invalid_credentials")


def test_token_of_the_settings_needs_no_database(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, metrics_token=TOKEN) as service:
        object.__setattr__(service.services, "database", Database("postgresql://nobody@/none?host=/nowhere"))
        assert "vitac_database_up 0.0" in service.client.get("/metrics", headers=bearer(TOKEN)).text


def test_metrics_say_within_seconds_that_the_database_stands_still(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = threading.Event()
    monkeypatch.setattr(exposition, "LIMIT_S", 0.05)
    monkeypatch.setattr(exposition, "operations", lambda *_: answers.wait(10.0))
    with running_service(database, tmp_path, metrics_token=TOKEN) as service:
        found = service.client.get("/metrics", headers=bearer(TOKEN)).text
        answers.set()
    assert "vitac_database_up 0.0" in found
    assert "vitac_server_disk_bytes" in found
