from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from httpx import Response
from images import config_bytes, docker_archive, entry, tar_bytes
from seeded_site import BEARS, GELBOTS, ORGANIZERS, SeededSite, form_token, words
from service_client import make_archive
from sqlalchemy import func, select
from uploaded_logs import a_log, a_text_log, packed
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.models import Submission

ADDRESS = "/submissions/upload"


def send(
    browser: AsgiBrowser, content: bytes, name: str = "mine.zip", *, token: str | None = None, **options: Any
) -> Response:
    fields = {"form_token": form_token(browser) if token is None else token} | options.pop("fields", {})
    return browser.post(ADDRESS, data=fields, files={"file": (name, content)}, **options)


def n_submissions(site: SeededSite) -> int:
    with site.database.reading() as session:
        return session.scalar(select(func.count()).select_from(Submission)) or 0


def test_the_form_says_what_is_possible_and_needs_no_script(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    assert f'href="{ADDRESS}"' in browser.get("/submissions").text
    html = browser.get(ADDRESS).text
    for shown in ('enctype="multipart/form-data"', 'type="file"', "512 MiB", "32 MiB", form_token(browser)):
        assert shown in html
    assert html.index('name="form_token"') < html.index('type="file"')  # fields are read before the file only
    assert 'name="team"' not in html


LAYER = tar_bytes([entry("submission.yaml", b"track: track_1\ntasks: [peg-insertion]\nname: boxed\n")])


def test_a_file_becomes_a_submission_of_its_kind(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    for name, content, kind in (
        ("Mine.ZIP", make_archive(), SubmissionKind.MODEL),
        ("policy.tar", docker_archive([LAYER], config_bytes([LAYER], ["/policy"])), SubmissionKind.IMAGE),
        ("run.jsonl.gz", packed(a_log(team=GELBOTS)), SubmissionKind.LOG),
        ("old.log", a_text_log(GELBOTS), SubmissionKind.TEXT_LOG),
        ("../../etc/passwd", make_archive(policy="class Policy: ..."), SubmissionKind.MODEL),
    ):
        answer = send(browser, content, name)
        assert answer.status_code == 303, name
        address = answer.headers["location"]
        with site.database.reading() as session:
            assert session.get_one(Submission, address.rpartition("/")[2]).kind is kind, name
        again = send(browser, content, name).headers["location"]
        assert again == f"{address}?known=yes"
        assert "You submitted this content before" in browser.get(again).text
        assert "You submitted this content before" not in browser.get(address).text


def test_organizers_name_the_team(site: SeededSite) -> None:
    browser = site.visitor(ORGANIZERS)
    assert 'name="team"' in browser.get(ADDRESS).text
    answer = send(browser, make_archive(), fields={"team": f" {BEARS} ", "again": "yes"})
    assert "Bears" in words(browser.get(answer.headers["location"]).text)


@pytest.mark.parametrize("content", [b"broken" * 100_000, bytes(3 << 20)], ids=["600 kB", "3 MiB"])
def test_a_refusal_is_shown_above_the_form_after_all_is_read(site: SeededSite, content: bytes) -> None:
    browser, before = site.visitor(GELBOTS), n_submissions(site)
    answer = send(browser, content)
    assert answer.status_code == 422
    assert 'role="alert"' in answer.text
    assert "zip" in words(answer.text.partition('role="alert"')[2].partition("</")[0])
    assert 'type="file"' in answer.text
    for_script = send(browser, content, headers={"accept": "application/json"})
    assert (for_script.status_code, for_script.json()["code"]) == (422, "archive_rejected")
    assert n_submissions(site) == before


def test_no_file_and_other_bodies_are_refused(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    answer = browser.post(ADDRESS, data={"form_token": form_token(browser)}, files={"file": ("", b"")})
    assert (answer.status_code, "Choose a file first." in answer.text) == (422, True)
    assert browser.post(ADDRESS, data={"form_token": form_token(browser)}).status_code == 415


def test_only_a_form_of_this_session_is_read(site: SeededSite) -> None:
    browser, before = site.visitor(GELBOTS), n_submissions(site)
    for token in ("", "00" * 32):
        assert send(browser, make_archive(), token=token).status_code == 403
    assert send(browser, make_archive(), headers={"sec-fetch-site": "cross-site"}).status_code == 403
    visitor = site.visitor()
    assert visitor.get(ADDRESS).headers["location"] == f"/sign-in?next={ADDRESS}"
    assert send(visitor, make_archive(), token="").status_code == 303
    assert n_submissions(site) == before
