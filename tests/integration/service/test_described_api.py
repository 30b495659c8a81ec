"""Requests made up from the API's own description, right and wrong ones, never meet an error of the server."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import requests
import schemathesis
from databases import opened_database
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable
from schemathesis import Case, GenerationMode
from schemathesis.core.result import Ok
from service_client import Service, make_archive, running_service

EXAMPLES = 3
"""Per operation, role and way of making them up; some operations have fewer that differ."""

MIN_REQUESTS = 300
"""Per role and way, so that at least 1,200 are sent in all."""

AnyCase = Case[Any]
ENDLESS = "/api/v1/submissions/{submission_id}/events"
"""Follows a submission for as long as it is evaluated; asked for ids that do not exist only."""

BOUNDED = settings(
    max_examples=EXAMPLES,
    derandomize=True,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=list(HealthCheck),
)
AWKWARD = st.sampled_from(
    ["\0", "0b_", "2001-99-99", "!!int a", "!!timestamp a", "&a [*a]", "{a: b}", "[]", "9" * 5000, "~", "!!python/none"]
)
KEYS = st.sampled_from(["track", "tasks", "name", "policy", "arguments", "further"])


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service with one submission, whose evaluation was cancelled."""
    with opened_database() as database:
        folder: Path = tmp_path_factory.mktemp("state")
        with running_service(database, folder, registrations_per_hour=1_000_000, client_share=1.0) as service:
            yield service


@pytest.fixture(scope="module")
def submission(live: Service) -> str:
    found: str = live.upload(make_archive()).json()["id"]
    live.post(f"/submissions/{found}/cancel")
    return found


@pytest.mark.slow
@pytest.mark.parametrize("mode", GenerationMode)
def test_no_request_of_a_description_meets_an_error_of_the_server(
    live: Service, submission: str, mode: GenerationMode
) -> None:
    schema = schemathesis.openapi.from_dict(live.client.get("/openapi.json").json())
    sent: dict[str, list[str]] = {live.token: [], live.organizer_token: []}
    for result in schema.get_all_operations():
        assert isinstance(result, Ok)
        operation = result.ok()
        for made_by in (operation.as_strategy(generation_mode=mode), disturbed(operation.as_strategy(), submission)):
            send_all(live, made_by, sent)
    for addresses in sent.values():
        assert len(addresses) >= MIN_REQUESTS
        assert any("%00" in address for address in addresses), "no request with a NUL among them"


def send_all(live: Service, cases: st.SearchStrategy[AnyCase], sent: dict[str, list[str]]) -> None:
    """Send what is made up, which takes longer than to answer it, once with each token; add the addresses asked."""

    base_url = "http://{}:{}".format(*live.address)

    @BOUNDED
    @given(case=cases)
    def send(case: AnyCase) -> None:
        for token, addresses in sent.items():
            try:
                answer = case.call(base_url=base_url, headers={"Authorization": f"Bearer {token}"}, session=connected)
            except (requests.exceptions.InvalidHeader, UnicodeError):
                return  # the client itself refuses to send it
            addresses.append(str(answer.request.url))
            assert answer.status_code < 500, f"{case.method} {case.formatted_path}: {answer.text}"

    # One connection for all: another one for each request took 1 to 2 ms of CPU.
    with requests.Session() as connected, suppress(Unsatisfiable):  # nothing can be wrong in a request without parts
        send()


def disturbed(cases: st.SearchStrategy[AnyCase], submission: str) -> st.SearchStrategy[AnyCase]:
    """Put an id that exists and values that programs stumble over into requests that are otherwise right."""
    return st.builds(_disturb, cases, st.just(submission), st.booleans(), st.lists(AWKWARD, min_size=1, max_size=3))


def _disturb(case: AnyCase, submission: str, has_awkward_query: bool, awkward: list[str]) -> AnyCase:
    if "submission_id" in (case.path_parameters or {}) and case.path != ENDLESS:
        case.path_parameters["submission_id"] = submission
    if has_awkward_query:
        case.query = {**(case.query or {}), **dict(zip(case.query or {"track": "", "team": ""}, awkward, strict=False))}
    if isinstance(case.body, dict):
        case.body = {key: awkward[0] if isinstance(value, str) else value for key, value in case.body.items()}
    return case


@schemathesis.serializer("application/offset+octet-stream", "application/pdf")
def send_as_it_is(context: object, value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogatepass")


MANIFESTS = st.one_of(
    st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")),
    st.binary(max_size=200),
    st.lists(st.tuples(KEYS, st.one_of(AWKWARD, st.text(max_size=20))), max_size=6).map(
        lambda pairs: "\n".join(f"{key}: {value}" for key, value in pairs).encode("utf-8", "surrogatepass")
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize("role", ["team", "organizer"])
def test_no_manifest_meets_an_error_of_the_server(live: Service, role: str) -> None:
    token, query = (live.token, "") if role == "team" else (live.organizer_token, "?team=Team%20A")
    seen: list[int] = []
    upload: Callable[..., Any] = live.upload

    @settings(BOUNDED, max_examples=100)
    @given(manifest=MANIFESTS)
    def send(manifest: bytes) -> None:
        archive = make_archive({"Track_1/submission.yaml": manifest, "Track_1/policy.py": "class Policy: ...\n"})
        answer = upload(archive, token, query)
        seen.append(answer.status_code)
        assert answer.status_code < 500, answer.text

    send()
    assert 422 in seen
