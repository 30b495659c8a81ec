import pytest
from service_client import Service
from vitac.server.database.metrics import list_samples


def counted(service: Service) -> dict[tuple[str, str, str], float]:
    """Requests by method, route and status."""
    found = {}
    for key, value in list_samples(service.services.instruments).items():
        if key.name == "vitac_request_seconds_count":
            labels = key.label_values()
            found[(labels["method"], labels["route"], labels["status"])] = value
    return found


def test_requests_are_counted_by_the_route_that_answers(service: Service) -> None:
    service.client.get("/health")
    service.get("/submissions/00000000-0000-0000-0000-000000000000")
    service.get("/submissions/00000000-0000-0000-0000-000000000001")
    service.get("/tracks/track_1")
    assert counted(service) == {
        ("GET", "/health", "2xx"): 1,
        ("GET", "/api/v1/submissions/{submission_id}", "4xx"): 2,
        ("GET", "/api/v1/tracks/{track}", "2xx"): 1,
    }


@pytest.mark.parametrize(("method", "path"), [("GET", "/made/up/1"), ("GET", "/made/up/2"), ("INVENT", "/made/up")])
def test_names_that_clients_make_up_are_no_labels(service: Service, method: str, path: str) -> None:
    service.client.request(method, path)
    ((counted_method, route, _),) = counted(service)
    assert route == "unknown"
    assert counted_method == ("GET" if method == "GET" else "unknown")


def test_refusals_of_request_heads_are_counted(service: Service) -> None:
    service.client.get("/health?a=%00")
    assert counted(service) == {("GET", "unknown", "4xx"): 1}
