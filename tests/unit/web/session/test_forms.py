import pytest
from asgi_browser import AsgiBrowser
from seeded_site import GELBOTS, SeededSite, form_token
from vitac.web.session.file_form import FORM_LIMIT_BYTES
from vitac.web.session.signer import local_target


@pytest.mark.parametrize(
    "headers",
    [
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "", "origin": "https://evil.test"},
    ],
)
def test_forms_of_other_sites_are_refused(site: SeededSite, headers: dict[str, str]) -> None:
    browser = site.visitor(GELBOTS)
    for path in ("/sign-in", "/sign-out", "/register", f"{site.path_of('runs')}/cancel"):
        answer = browser.post(path, data={"form_token": form_token(browser)}, headers=headers)
        assert answer.status_code == 403
        assert "another site" in answer.text


def test_a_form_that_is_none_is_refused_and_told_what_was_expected(browser: AsgiBrowser) -> None:
    other = browser.post("/sign-in", json={"token": "x"})
    assert (other.status_code, "got application/json" in other.text) == (415, True)
    empty = browser.post("/sign-in")
    assert (empty.status_code, "got no content type" in empty.text) == (415, True)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"origin": "http://testserver"}, 303),
        ({"sec-fetch-site": "none"}, 303),
        ({}, 303),  # as of a command-line client, which no other site can start
        *(
            ({"origin": origin}, 403)
            for origin in ("null", "https://testserver.evil.test", "http://[", "testserver", "")
        ),
    ],
)
def test_browsers_that_tell_less_are_believed_by_their_origin(
    site: SeededSite, headers: dict[str, str], status: int
) -> None:
    browser = site.visitor(headers=headers)
    assert browser.post("/sign-in", data={"token": site.token_of(GELBOTS)}).status_code == status


@pytest.mark.parametrize(("bytes_beyond", "status"), [(0, 401), (1, 413)])
def test_a_form_may_be_as_long_as_the_limit(browser: AsgiBrowser, bytes_beyond: int, status: int) -> None:
    token = "x" * (FORM_LIMIT_BYTES - len("token=") + bytes_beyond)
    assert browser.post("/sign-in", data={"token": token}).status_code == status


def test_a_media_type_with_parameters_and_capitals_is_a_form_whose_last_field_of_a_name_counts(
    site: SeededSite, browser: AsgiBrowser
) -> None:
    media_type = {"content-type": "Application/X-WWW-Form-Urlencoded; charset=utf-8"}
    for tokens, status in (("token=wrong&token={}", 303), ("token={}&token=wrong", 401), ("token=\xff%ff%00", 401)):
        content = tokens.format(site.token_of(GELBOTS)).encode("latin-1")
        assert browser.post("/sign-in", content=content, headers=media_type).status_code == status


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
