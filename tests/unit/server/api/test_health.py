import threading
from pathlib import Path

import pytest
from service_client import Service
from service_factories import TRACK
from sqlalchemy import text
from vitac.server.api import health
from vitac.server.database.engine import Database


def test_healthy_and_ready_service_says_so_without_workers(service: Service) -> None:
    assert service.client.get("/health").json()["status"] == "ok"
    answer = service.client.get("/ready")
    assert (answer.status_code, answer.json()["status"]) == (200, "ready")
    assert answer.json()["workers"] == {
        "alive": 0,
        "last_heartbeat_at": None,
        "missing_family": None,
        "missing_evaluator": None,
        "lacks_gpu": False,
    }


def test_schema_of_another_version_makes_the_service_unready(service: Service) -> None:
    with service.database.transaction() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '0000'"))
    answer = service.client.get("/ready")
    assert (answer.status_code, answer.json()["database"]) == (503, "ok")
    assert "has schema 0000, expected " in answer.json()["migrations"]


def test_store_that_cannot_be_written_makes_the_service_unready(service: Service) -> None:
    folder: Path = service.settings.state_dir / "blobs"
    folder.rmdir()
    folder.write_text("not a folder")
    answer = service.client.get("/ready")
    assert (answer.status_code, answer.json()["database"]) == (503, "ok")
    assert "The file store does not work" in answer.json()["storage"]


def test_store_that_hangs_makes_the_service_unready_within_seconds(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = threading.Event()
    monkeypatch.setattr(health, "LIMIT_S", 0.05)
    monkeypatch.setattr(service.services.blobs, "check", lambda: answers.wait(60.0))
    answer = service.client.get("/ready")
    answers.set()
    assert (answer.status_code, answer.json()["storage"]) == (503, "does not answer within 0.05 s")


def test_database_that_is_away_makes_the_service_unready_but_not_unhealthy(service: Service) -> None:
    away = Database("postgresql://nobody@/none?host=/nowhere")
    object.__setattr__(service.services, "database", away)
    answer = service.client.get("/ready")
    assert (answer.status_code, answer.json()["database"]) == (503, "does not answer")
    assert service.client.get("/health").status_code == 200
    problem = service.client.get(f"/api/v1/leaderboards/{TRACK}")
    assert (problem.status_code, problem.json()["code"]) == (503, "database_unavailable")


def test_a_database_that_stands_still_makes_the_service_unready_within_seconds(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = threading.Event()
    monkeypatch.setattr(health, "LIMIT_S", 0.05)
    monkeypatch.setattr(health, "workers_alive", lambda *_: answers.wait(60.0))
    found = [service.client.get("/ready") for _ in range(3)]
    answers.set()
    assert {(answer.status_code, answer.json()["database"]) for answer in found} == {(503, "does not answer")}


def test_openapi_describes_every_route_and_loads_nothing_from_elsewhere(service: Service) -> None:
    document = service.client.get("/openapi.json").json()
    routes = [route for methods in document["paths"].values() for route in methods.values()]
    assert all(route.get("description") for route in routes)
    upload = document["paths"]["/api/v1/submissions"]["post"]
    assert "application/zip" in upload["requestBody"]["content"]
    assert {"200", "202", "default"} <= upload["responses"].keys()
    for path in ("/docs", "/redoc"):
        assert service.client.get(path).status_code == 404
