import shutil
from pathlib import Path

import pytest
from asgi_browser import AsgiBrowser
from fastapi import FastAPI
from page_service import FixedData, an_application
from vitac.web.headers import CONTENT_SECURITY_POLICY
from vitac.web.pages import documentation
from vitac.web.pages.documentation import POLICY_FILE

POLICY = "default-src 'none'; script-src 'self' 'sha256-x'"


@pytest.fixture
def site(tmp_path: Path) -> Path:
    (tmp_path / "start").mkdir()
    (tmp_path / "index.html").write_text("<h1>Documentation</h1>")
    (tmp_path / "start" / "visitor.html").write_text("<h1>Visit</h1>")
    (tmp_path / POLICY_FILE).write_text(POLICY + "\n")
    return tmp_path


def application(data: FixedData, site: Path, monkeypatch: pytest.MonkeyPatch) -> FastAPI:
    monkeypatch.setattr(documentation, "SITE", site)
    return an_application(data)


def test_pages_come_with_the_policy_of_the_site(data: FixedData, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    browser = AsgiBrowser(application(data, site, monkeypatch))
    for path, heading in (("/docs/", "Documentation"), ("/docs/start/visitor.html", "Visit")):
        answer = browser.get(path)
        assert (answer.status_code, answer.text) == (200, f"<h1>{heading}</h1>")
        assert answer.headers["content-security-policy"] == POLICY
        assert answer.headers["cache-control"] == "no-cache"
    assert browser.get("/").headers["content-security-policy"] == CONTENT_SECURITY_POLICY


@pytest.mark.parametrize("path", ["/docs/none.html", "/docs/../secret", "/docs/%2e%2e/secret", "/docs/start"])
def test_nothing_but_the_site_is_served(
    data: FixedData, site: Path, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    (site.parent / "secret").write_text("secret")
    answer = AsgiBrowser(application(data, site, monkeypatch)).get(path)
    assert answer.status_code == 404
    assert "secret" not in answer.text


def test_a_site_that_was_not_built_says_how_to_build_it(
    data: FixedData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = AsgiBrowser(application(data, tmp_path / "missing", monkeypatch)).get("/docs/")
    assert answer.status_code == 503
    assert "./vitac serve builds it while it runs (a minute or two, once)" in answer.text
    assert "./vitac demo shows it from then on" in answer.text


def test_a_site_that_is_built_while_the_service_runs_appears_with_its_own_policy(
    data: FixedData, site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = tmp_path / "served"
    browser = AsgiBrowser(application(data, served, monkeypatch))
    assert browser.get("/docs/").status_code == 503
    (site / "index.html").rename(site / "start" / "index.html")
    (site / "start").rename(served)
    assert browser.get("/docs/").status_code == 503, "a site without its policy is not shown"
    (site / POLICY_FILE).rename(served / POLICY_FILE)
    for policy in (POLICY, "default-src 'self'"):
        (served / POLICY_FILE).write_text(policy)
        answer = browser.get("/docs/")
        assert (answer.status_code, answer.headers["content-security-policy"]) == (200, policy)
    shutil.rmtree(served)
    assert browser.get("/docs/").status_code == 503


def test_every_page_leads_to_the_documentation(browser: AsgiBrowser) -> None:
    for path in ("/", "/tracks/track_1/rules", "/register"):
        assert '<a href="/docs/">Documentation</a>' in browser.get(path).text
