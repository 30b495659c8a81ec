from seeded_site import GELBOTS, ORGANIZERS, SeededSite, words
from submission_steps import make_worker
from vitac.server.database.states import WorkerState

GIB = 1 << 30


def test_organizer_sees_queue_workers_storage_and_counts(site: SeededSite) -> None:
    site.visitor(ORGANIZERS)
    assert "vitac worker" in words(site.visitor(ORGANIZERS).get("/operations").text), "how to start the first worker"
    make_worker(site.database, host="one", disk_bytes=100 * GIB, disk_free_bytes=12 * GIB)
    make_worker(site.database, host="two", state=WorkerState.REFUSING, message="The sandbox of <this> is not sound.")
    html = site.visitor(ORGANIZERS).get("/operations").text
    for text in ("Ready", "Refusing", "&lt;this&gt;", "12 GiB of 100 GiB"):
        assert text in html, text


def test_only_organizers_find_and_see_the_page(site: SeededSite) -> None:
    assert site.visitor().get("/operations").headers["location"] == "/sign-in?next=/operations"
    team = site.visitor(GELBOTS)
    assert "/operations" not in team.get("/submissions").text
    refused = team.get("/operations")
    assert (refused.status_code, "for organizers" in refused.text) == (403, True)
    assert 'href="/operations"' in site.visitor(ORGANIZERS).get("/submissions").text
