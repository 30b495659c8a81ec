"""How the application is put together: where its routes are, what stands around them, and what they are counted by."""

from pathlib import Path

import pytest
from databases import opened_database
from fastapi import FastAPI
from fastapi.routing import APIRoute
from service_client import API, Service, running_service
from vitac.server.api.app import API_PREFIX, UNLIMITED, create_app
from vitac.server.errors import ServiceError
from vitac.server.settings import Settings, load_settings


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return load_settings(
        database_url="postgresql:///unused",
        state_dir=tmp_path_factory.mktemp("state"),
        registrations_per_hour=2,
        sign_ins_per_hour=8,
        uploads_at_once=1,
        event_streams=1,
    )


@pytest.fixture(scope="module")
def app(settings: Settings) -> FastAPI:
    return create_app(settings, uploads_at=(("POST", "/upload"),))


def paths_of(app: FastAPI) -> dict[str, set[str]]:
    """Paths of the description, each with its methods."""
    return {path: {method.upper() for method in item} for path, item in app.openapi()["paths"].items()}


def test_everything_but_health_metrics_and_files_of_the_log_is_below_the_prefix_of_the_version(app: FastAPI) -> None:
    outside = {path for path in paths_of(app) if not path.startswith((API_PREFIX, "/log/"))}
    assert outside == {"/health", "/ready", "/metrics"}
    assert len(paths_of(app)) - len(outside) > 30


def test_no_two_routes_answer_the_same_request(app: FastAPI) -> None:
    found = [
        (method, route.path) for route in app.routes if isinstance(route, APIRoute) for method in route.methods or ()
    ]
    assert len(found) == len(set(found))


def test_routes_without_a_limit_on_their_body_are_those_that_take_uploads(app: FastAPI) -> None:
    paths = paths_of(app)
    for method, path in UNLIMITED:
        matching = {found for found in paths if found == path or (path.endswith("/") and found.startswith(path))}
        assert any(method in paths[found] for found in matching), (method, path)


def test_middleware_measures_everything_and_limits_bodies_last(app: FastAPI) -> None:
    names = [each.cls.__name__ for each in app.user_middleware]  # type: ignore[attr-defined]
    assert names == [
        *("RequestIds", "RequestTimes", "Shutdown", "Shares"),
        *("RequestHead", "RelativeRedirects", "ProtocolVersion", "BodyLimit"),
    ]
    body_limit = app.user_middleware[-1].kwargs
    assert body_limit["unlimited"] == (*UNLIMITED, ("POST", "/upload"))


def test_there_are_no_pages_that_load_scripts_from_elsewhere(app: FastAPI) -> None:
    assert (app.docs_url, app.redoc_url) == (None, None)
    assert app.openapi_url == "/openapi.json"


def used_up(note: object, key: str, count: int) -> bool:
    """Counts so often, and tells whether one more is refused."""
    assert callable(note)
    for _ in range(count):
        note(key, "tries")
    with pytest.raises(ServiceError) as refused:
        note(key, "tries")
    return f"At most {count} tries in 3600 s" in str(refused.value)


def test_each_limit_is_that_of_its_setting_and_has_files_of_its_own(app: FastAPI, settings: Settings) -> None:
    sign_ins = app.state.sign_in_limiters
    assert used_up(app.state.registration_limiter.note, "somebody", 2)
    assert used_up(sign_ins.of_address.note, "somebody", 8)
    assert used_up(sign_ins.of_member.note, "somebody", 2), "a quarter for one name"
    folders = {path.name for path in (settings.state_dir / "limits").iterdir() if path.is_dir()}
    assert {"registrations", "sign_ins", "sign_ins_of_members"} <= folders


def test_two_servers_of_one_machine_count_together(app: FastAPI, settings: Settings) -> None:
    other = create_app(settings)
    app.state.registration_limiter.note("a third", "tries")
    other.state.registration_limiter.note("a third", "tries")
    with pytest.raises(ServiceError):
        other.state.registration_limiter.note("a third", "tries")


def test_a_single_sign_in_an_hour_is_one_for_a_member_too(tmp_path: Path) -> None:
    strict = load_settings(database_url="postgresql:///unused", state_dir=tmp_path, sign_ins_per_hour=1)
    assert used_up(create_app(strict).state.sign_in_limiters.of_member.note, "somebody", 1)


@pytest.mark.slow
def test_applications_of_one_process_share_their_routes_and_no_state(service: Service, tmp_path: Path) -> None:
    with (
        opened_database() as database,
        running_service(database, tmp_path / "other", registrations_per_hour=1) as other,
    ):
        assert other.client.get("/openapi.json").json() == service.client.get("/openapi.json").json()
        assert other.client.get(f"{API}/nothing-here").status_code == 404
        taken = [other.client.post(f"{API}/teams", json={"name": f"Team of {n}"}).status_code for n in "12"]
        assert taken == [201, 429]
        assert service.client.post(f"{API}/teams", json={"name": "Team of 1"}).status_code == 201
        assert other.get("/submissions", service.token).status_code == 401
        assert other.get("/submissions").status_code == service.get("/submissions").status_code == 200
