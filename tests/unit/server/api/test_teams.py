from pathlib import Path

from service_client import Service, bearer, problem_of, running_service
from vitac.server.database.engine import Database


def test_registered_team_gets_a_token_that_works_and_is_shown_once(service: Service) -> None:
    answer = service.client.post("/api/v1/teams", json={"name": "New", "contact": "new@example.org"})
    assert answer.status_code == 201
    token = answer.json()["token"]
    assert (token["role"], token["team"], token["expires_at"] is not None) == ("team", "New", True)
    me = service.get("/me", token["secret"]).json()
    assert (me["role"], me["team"], me["token"]["id"]) == ("team", answer.json()["team"], token["id"])
    listed = service.get("/tokens", token["secret"]).json()["items"]
    assert [item["id"] for item in listed] == [token["id"]]
    assert "secret" not in listed[0]


def test_team_name_that_is_taken_or_wrong_is_refused(service: Service) -> None:
    problem_of(service.client.post("/api/v1/teams", json={"name": "TEAM A"}), 409, "team_exists")
    bodies: tuple[object, ...] = ({}, {"name": ""}, {"name": "ok", "extra": 1}, {"name": "ok", "contact": "a\nb"}, [])
    for body in bodies:
        problem_of(service.client.post("/api/v1/teams", json=body), 422, "invalid_request")


def test_closed_registration_is_for_organizers(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, registration="closed") as service:
        body = {"name": "New"}
        problem_of(service.client.post("/api/v1/teams", json=body), 403, "registration_closed")
        problem_of(service.post("/teams", json=body), 403, "registration_closed")
        assert service.post("/teams", service.organizer_token, json=body).status_code == 201


def test_one_address_registers_only_so_many_teams_an_hour(database: Database, tmp_path: Path) -> None:
    with running_service(database, tmp_path, registrations_per_hour=2) as service:
        for name in ("one", "two"):
            assert service.client.post("/api/v1/teams", json={"name": name}).status_code == 201
        answer = service.client.post("/api/v1/teams", json={"name": "three"})
        problem_of(answer, 429, "too_many_requests")
        assert int(answer.headers["retry-after"]) > 3000
        assert service.post("/teams", service.organizer_token, json={"name": "three"}).status_code == 201


def test_team_makes_and_revokes_further_tokens(service: Service) -> None:
    answer = service.post("/tokens", json={"label": "laptop", "expires_in_days": 3})
    assert (answer.status_code, answer.json()["label"]) == (201, "laptop")
    secret, identity = answer.json()["secret"], answer.json()["id"]
    assert service.get("/me", secret).status_code == 200
    assert service.client.delete(f"/api/v1/tokens/{identity}", headers=bearer(service.token)).status_code == 204
    problem_of(service.get("/me", secret), 401, "invalid_credentials")


def test_only_organizers_make_tokens_for_others_and_for_organizers(service: Service) -> None:
    problem_of(service.post("/tokens", json={"label": "x", "team": "Team B"}), 403, "forbidden")
    made = service.post("/tokens", service.organizer_token, json={"label": "x", "team": "Team B"}).json()
    assert service.get("/me", made["secret"]).json()["team"]["name"] == "Team B"
    organizer = service.post("/tokens", service.organizer_token, json={"label": "x"}).json()
    assert service.get("/me", organizer["secret"]).json() == {
        "role": "organizer",
        "team": None,
        "token": service.get("/me", organizer["secret"]).json()["token"],
        "quotas": [],
        "stage_quotas": [],
    }


def test_lifetime_has_bounds(service: Service) -> None:
    for days in [0, -1, 100_000]:
        problem_of(service.post("/tokens", json={"label": "x", "expires_in_days": days}), 422, "invalid_request")
