import pytest
from asgi_browser import AsgiBrowser
from page_service import FixedData, an_application
from visits import RUNNING, form_token, sign_in
from vitac.web.session.signer import FORM_LIMIT_BYTES, local_target


@pytest.mark.parametrize(
    "headers",
    [
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "", "origin": "https://evil.test"},
    ],
)
def test_forms_of_other_sites_are_refused(browser: AsgiBrowser, headers: dict[str, str]) -> None:
    sign_in(browser, "Gelbots")
    for path in ("/sign-in", "/sign-out", f"/submissions/{RUNNING.id}/cancel"):
        answer = browser.post(path, data={"form_token": form_token(browser)}, headers=headers)
        assert answer.status_code == 403
        assert "another site" in answer.text


def test_forms_of_old_browsers_are_accepted_from_this_origin(data: FixedData) -> None:
    browser = AsgiBrowser(an_application(data), headers={"origin": "http://testserver"})
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots"}).status_code == 303


def test_a_form_that_is_too_long_or_none_is_refused(browser: AsgiBrowser) -> None:
    assert browser.post("/sign-in", data={"token": "x" * 70_000}).status_code == 413
    assert browser.post("/sign-in", json={"token": "x"}).status_code == 415
    assert browser.post("/sign-in").status_code == 415


@pytest.mark.parametrize("origin", ["null", "https://testserver.evil.test", "http://[", "testserver", ""])
def test_forms_of_old_browsers_from_another_origin_are_refused(data: FixedData, origin: str) -> None:
    browser = AsgiBrowser(an_application(data), headers={"origin": origin})
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots"}).status_code == 403


def test_a_form_that_tells_no_origin_is_accepted(data: FixedData) -> None:
    """Such as that of a command-line client, which no other site can start."""
    browser = AsgiBrowser(an_application(data), headers={})
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots"}).status_code == 303


def test_a_form_that_the_user_opened_is_accepted(data: FixedData) -> None:
    browser = AsgiBrowser(an_application(data), headers={"sec-fetch-site": "none"})
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots"}).status_code == 303


@pytest.mark.parametrize(("bytes_beyond", "status"), [(0, 401), (1, 413)])
def test_a_form_may_be_as_long_as_the_limit(browser: AsgiBrowser, bytes_beyond: int, status: int) -> None:
    token = "x" * (FORM_LIMIT_BYTES - len("token=") + bytes_beyond)
    assert browser.post("/sign-in", data={"token": token}).status_code == status


def test_a_refused_form_is_told_what_was_expected(browser: AsgiBrowser) -> None:
    assert (
        "expected a form of at most 65536 bytes" in browser.post("/sign-in", data={"token": "x" * 70_000}).text.lower()
    )
    assert "got application/json" in browser.post("/sign-in", json={}).text
    assert "got no content type" in browser.post("/sign-in").text


def test_a_media_type_with_parameters_and_capitals_is_a_form(browser: AsgiBrowser) -> None:
    media_type = "Application/X-WWW-Form-Urlencoded; charset=utf-8"
    answer = browser.post("/sign-in", content=b"token=token-of-Gelbots", headers={"content-type": media_type})
    assert answer.status_code == 303


def test_bytes_that_are_no_text_are_a_wrong_token(browser: AsgiBrowser) -> None:
    media_type = {"content-type": "application/x-www-form-urlencoded"}
    assert browser.post("/sign-in", content=b"token=\xff%ff%00", headers=media_type).status_code == 401


def test_of_equal_fields_the_last_one_counts(browser: AsgiBrowser) -> None:
    answer = browser.post("/sign-in", data={"token": ["token-of-nobody", "token-of-Gelbots"]})
    assert answer.status_code == 303


@pytest.mark.parametrize("target", ["/", "/submissions/1?refresh=off#top", "/tracks/track_1?task=a//b", "/x?y=["])
def test_a_path_of_this_site_is_kept(target: str) -> None:
    assert local_target(target) == target


@pytest.mark.parametrize(
    "target", ["//[", "http://[", "///evil.test", "/\t/evil.test", "/\n/evil.test", "/a\\b", " /x", "/\x00", "/\u202e"]
)
def test_what_a_browser_might_take_for_another_site_is_not_kept(target: str) -> None:
    assert local_target(target) == "/submissions"


def test_a_damaged_target_does_not_break_the_sign_in_page(browser: AsgiBrowser) -> None:
    assert browser.get("/sign-in?next=//[").status_code == 200
