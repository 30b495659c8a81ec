import re
from typing import Any

from asgi_browser import AsgiBrowser
from page_fixtures import a_sandbox
from seeded_site import SeededSite
from submission_steps import make_worker


def show(site: SeededSite, *sandboxes: Any) -> str:
    for sandbox in sandboxes:
        make_worker(site.database, sandbox=sandbox.model_dump(mode="json"))
    return site.visitor().get("/sandbox").text


def test_it_shows_what_the_workers_sandboxes_tell_with_packages_by_name(site: SeededSite) -> None:
    # The database hands out the keys of JSON by their length.
    packages = {"six": "1.17", "Pillow": "12.1", "numpy": "2.4.6", "<b>": "3"}
    html = show(site, a_sandbox(packages=packages))
    assert "manylinux_2_28_x86_64" in html
    assert "of sandbox" not in html, "one kind of worker has no number"
    listed = html.partition('class="packages"')[2].partition("</dl>")[0]
    assert re.findall(r"<dt>([\w&;]+)</dt>", listed) == ["&lt;b&gt;", "numpy", "Pillow", "six"]
    assert re.findall(r"<dd>([\d.]+)</dd>", listed) == ["3", "2.4.6", "12.1", "1.17"]
    html = show(site, a_sandbox(machine="aarch64", simd=()))
    for shown in (
        "x86_64 with X86_V2, X86_V3",
        "aarch64 with no vector extensions",
        "Packages of sandbox 2",
        "Processes and threads",
    ):
        assert shown in html


def test_before_the_first_worker_it_says_so(browser: AsgiBrowser) -> None:
    html = browser.get("/sandbox").text
    assert "No worker has started yet" in html
    assert "pip install --target FOLDER" in html


def test_the_rules_and_every_page_link_to_it(browser: AsgiBrowser) -> None:
    assert browser.get("/tracks/track_1/rules").text.count('href="/sandbox"') == 2
    assert browser.get("/register").text.count('href="/sandbox"') == 1
