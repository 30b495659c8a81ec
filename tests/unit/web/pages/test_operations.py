from asgi_browser import AsgiBrowser
from page_fixtures import a_worker, an_operations_view
from page_service import FixedData
from visits import sign_in
from vitac.server.database.states import WorkerState


def shown(browser: AsgiBrowser) -> str:
    sign_in(browser, "organizers")
    answer = browser.get("/operations")
    assert answer.status_code == 200
    return answer.text.replace("\N{NARROW NO-BREAK SPACE}", " ")


def test_organizer_sees_queue_workers_storage_and_counts(data: FixedData, browser: AsgiBrowser) -> None:
    data.service = an_operations_view(
        a_worker(WorkerState.READY), a_worker(WorkerState.READY, is_lost=True),
        a_worker(WorkerState.REFUSING, message="The sandbox of <this> machine is not sound."),
    )  # fmt: skip
    html = shown(browser)
    for text in ("18 000", "1 h 01 min", "0.90", "Lost", "Ready", "Refusing", "&lt;this&gt;", "12 GiB of 100 GiB"):
        assert text in html, text
    assert "within 50 ms" in html
    assert "beyond what is counted" in html


def test_service_without_workers_says_how_to_start_one(data: FixedData, browser: AsgiBrowser) -> None:
    data.service = an_operations_view()
    assert "vitac worker" in shown(browser)


def test_only_organizers_find_and_see_the_page(browser: AsgiBrowser) -> None:
    assert browser.get("/operations").headers["location"] == "/sign-in?next=/operations"
    sign_in(browser, "Gelbots")
    assert "/operations" not in browser.get("/submissions").text
    refused = browser.get("/operations")
    assert refused.status_code == 403
    assert "for organizers" in refused.text
    sign_in(browser, "organizers")
    assert 'href="/operations"' in browser.get("/submissions").text
