import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import FixedData, an_application
from visits import RUNNING, form_token, sign_in


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
    assert browser.post("/sign-in", data={"token": "x" * 10_000}).status_code == 413
    assert browser.post("/sign-in", json={"token": "x"}).status_code == 415
    assert browser.post("/sign-in").status_code == 415
