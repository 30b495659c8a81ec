import re

from asgi_browser import AsgiBrowser
from page_fixtures import a_sandbox
from page_service import FixedData


def test_it_shows_what_the_workers_sandboxes_tell(data: FixedData, browser: AsgiBrowser) -> None:
    data.described = [a_sandbox(packages={"numpy": "2.4.6", "<b>": "1"}), a_sandbox(machine="aarch64", simd=())]
    html = browser.get("/sandbox").text
    for shown in (
        "x86_64 with X86_V2, X86_V3",
        "aarch64 with no vector extensions",
        "Packages of sandbox 2",
        "2.4.6",
        "&lt;b&gt;",
        "manylinux_2_28_x86_64",
        "Processes and threads",
    ):
        assert shown in html


def test_packages_are_listed_by_name(data: FixedData, browser: AsgiBrowser) -> None:
    # The database hands out the keys of JSON by their length.
    data.described = [a_sandbox(packages={"six": "1.17", "Pillow": "12.1", "numpy": "2.4.6", "accessible": "3"})]
    html = browser.get("/sandbox").text
    listed = html.partition('class="packages"')[2].partition("</dl>")[0]
    assert re.findall(r"<dt>(\w+)</dt>", listed) == ["accessible", "numpy", "Pillow", "six"]
    assert re.findall(r"<dd>([\d.]+)</dd>", listed) == ["3", "2.4.6", "12.1", "1.17"]


def test_one_kind_of_worker_has_no_number(data: FixedData, browser: AsgiBrowser) -> None:
    data.described = [a_sandbox()]
    assert "of sandbox" not in browser.get("/sandbox").text


def test_before_the_first_worker_it_says_so(browser: AsgiBrowser) -> None:
    html = browser.get("/sandbox").text
    assert "No worker has started yet" in html
    assert "pip install --target FOLDER" in html


def test_the_rules_and_every_page_link_to_it(browser: AsgiBrowser) -> None:
    assert browser.get("/tracks/track_1/rules").text.count('href="/sandbox"') == 2
    assert browser.get("/register").text.count('href="/sandbox"') == 1
