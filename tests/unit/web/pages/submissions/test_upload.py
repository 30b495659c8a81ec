from pathlib import Path
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from cli_service import CliService, cli_service
from httpx import Client, Response
from page_service import FixedData
from service_client import make_archive
from visits import RUNNING, form_token, sign_in
from vitac.evaluator.submission_kinds import SubmissionKind

ADDRESS = "/submissions/upload"


def send(
    browser: AsgiBrowser, content: bytes, name: str = "mine.zip", *, token: str | None = None, **options: Any
) -> Response:
    fields = {"form_token": form_token(browser) if token is None else token} | options.pop("fields", {})
    return browser.post(ADDRESS, data=fields, files={"file": (name, content)}, **options)


def test_the_form_says_what_is_possible_and_needs_no_script(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    assert f'href="{ADDRESS}"' in browser.get("/submissions").text
    html = browser.get(ADDRESS).text
    for shown in ('enctype="multipart/form-data"', 'type="file"', "512 MiB", "32 MiB", form_token(browser)):
        assert shown in html
    assert html.index('name="form_token"') < html.index('type="file"')  # fields are read before the file only
    assert 'name="team"' not in html


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("Mine.ZIP", SubmissionKind.MODEL),
        ("run.jsonl.gz", SubmissionKind.LOG),
        ("old.log", SubmissionKind.TEXT_LOG),
        ("../../etc/passwd", SubmissionKind.MODEL),
    ],
)
def test_a_file_becomes_a_submission(data: FixedData, browser: AsgiBrowser, name: str, kind: SubmissionKind) -> None:
    sign_in(browser, "Gelbots")
    answer = send(browser, b"PK" * 40_000, name)
    assert (answer.status_code, answer.headers["location"]) == (303, f"/submissions/{RUNNING.id}")
    [(announced, content)] = data.uploaded
    assert (announced.kind, announced.team, announced.again) == (kind, None, False)
    assert content == b"PK" * 40_000


def test_content_that_was_submitted_before_does_not_look_new(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = send(browser, b"known")
    assert answer.headers["location"] == f"/submissions/{RUNNING.id}?known=yes"
    assert "You submitted this content before" in browser.get(answer.headers["location"]).text
    assert "You submitted this content before" not in browser.get(f"/submissions/{RUNNING.id}").text


def test_organizers_name_the_team(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "organizers")
    assert 'name="team"' in browser.get(ADDRESS).text
    send(browser, b"PK", fields={"team": " Gelbots ", "again": "yes"})
    assert [(announced.team, announced.again) for announced, _ in data.uploaded] == [("Gelbots", True)]


def test_a_refusal_is_shown_above_the_form_after_all_is_read(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = send(browser, b"broken" * 100_000)
    assert answer.status_code == 422
    assert "The archive is &lt;broken&gt;. Pack it again." in answer.text
    assert 'type="file"' in answer.text
    assert data.uploaded == []


def test_the_script_gets_a_refusal_as_a_problem(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = send(browser, b"broken", headers={"accept": "application/json"})
    assert answer.status_code == 422
    assert "<html" not in answer.text


def test_no_file_is_told(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = browser.post(ADDRESS, data={"form_token": form_token(browser)}, files={"file": ("", b"")})
    assert answer.status_code == 422
    assert "Choose a file first." in answer.text
    assert data.uploaded == []


@pytest.mark.parametrize("token", ["", "00" * 32])
def test_only_a_form_of_this_session_is_read(data: FixedData, browser: AsgiBrowser, token: str) -> None:
    sign_in(browser, "Gelbots")
    assert send(browser, b"PK", token=token).status_code == 403
    assert send(browser, b"PK", headers={"sec-fetch-site": "cross-site"}).status_code == 403
    assert data.uploaded == []


def test_it_is_for_teams_that_have_signed_in(data: FixedData, browser: AsgiBrowser) -> None:
    assert browser.get(ADDRESS).headers["location"] == f"/sign-in?next={ADDRESS}"
    assert send(browser, b"PK", token="").status_code == 303
    assert data.uploaded == []


def test_other_bodies_are_refused(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    assert browser.post(ADDRESS, data={"form_token": form_token(browser)}).status_code == 415


def signed_in(service: CliService, client: Client) -> str:
    """Signs in and returns the form's token."""
    client.post("/sign-in", data={"token": service.environment["VITAC_TOKEN"]})
    return client.get(ADDRESS).text.partition('name="form_token" value="')[2].partition('"')[0]


def test_an_archive_of_any_allowed_size_becomes_the_submission_that_the_api_makes(tmp_path: Path) -> None:
    archive = make_archive()
    with (
        cli_service(tmp_path) as service,
        Client(base_url=service.address, headers={"accept": "text/html"}, trust_env=False) as client,
    ):
        token = signed_in(service, client)
        answer = client.post(ADDRESS, data={"form_token": token}, files={"file": ("mine.zip", archive)})
        assert answer.status_code == 303
        address = answer.headers["location"]
        assert "zero" in client.get(address).text
        # Larger than any other body may be, and no archive: the service's own rules are asked, and nothing stays.
        broken = client.post(ADDRESS, data={"form_token": token}, files={"file": ("big.zip", bytes(3 << 20))})
        assert (broken.status_code, '<form id="upload"' in broken.text) == (422, True)
