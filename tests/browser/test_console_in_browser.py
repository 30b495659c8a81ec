"""The console of a station at a tablet's size: two operators play a trial on a twin, and stop it without a service."""

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, Final

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from scripted_policies import Scripted
from vitac.evaluator.episodes.records import HelpKind, make_reading
from vitac.evaluator.strict_model import validate
from vitac.evaluator.tracks import Episode, load_track
from vitac.station.console.server import ConsoleServer
from vitac.station.description import StationDescription
from vitac.station.operators import Operator
from vitac.station.outcome import TrialOutcome
from vitac.station.trial import Attempt
from vitac.station.trials import TrialPlayer
from vitac.station.twin.hidden import HiddenSettings
from vitac.station.twin.laboratory import twin_process
from waiting import until

TASK = load_track("track_1").tasks["peg-insertion"]
TABLET, PORTRAIT = (1024, 768), (768, 1024)
LIMIT_MS: Final = 60_000
CODE = "0123456789ABCDEF"


@pytest.fixture(scope="module")
def player(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TrialPlayer]:
    with twin_process(HiddenSettings(latency_s=0.0), period_s=0.2) as twin:
        description = validate(StationDescription, twin.description, "station.yaml")
        operator = Operator(asks=True)
        folder = tmp_path_factory.mktemp("trial")
        with TrialPlayer(description=description, folder=folder, operator=operator, attempts=1) as player:
            yield player


@pytest.fixture
def address(player: TrialPlayer) -> Iterator[str]:
    with ConsoleServer(player) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server.address
        server.shutdown()
        thread.join()


@pytest.fixture
def opened(browser: Browser, address: str) -> Iterator[Page]:
    context = browser.new_context(viewport={"width": TABLET[0], "height": TABLET[1]})
    page = context.new_page()
    faults: list[str] = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(address)
    yield page
    context.close()
    assert faults == []


def begin(player: TrialPlayer) -> "Future[list[Attempt]]":
    """A trial that runs beside the pages."""
    episode = Episode(number=7, shape="cuboid", offset=(2.0, -1.5, 3.0), offset_option="offset_mm_deg", list_seed=0)
    session = Scripted(lambda _observation, _number: np.zeros(3, np.float32))
    play: Any = lambda: player.play(TASK, episode, make_reading(TASK), lambda: session, CODE)  # noqa: E731
    return ThreadPoolExecutor(1).submit(play)


def check_all(page: Page) -> None:
    for box in page.locator("#checklist input").all():
        box.check()


@pytest.mark.slow(minutes=1)
def test_two_operators_play_a_trial_help_it_stop_the_next_and_release_the_station(
    opened: Page, player: TrialPlayer, address: str
) -> None:
    page, other = opened, opened.context.new_page()
    other.goto(address)
    trial = begin(player)
    accept = page.get_by_role("button", name="Accept")
    expect(page.locator("#text")).to_contain_text("The station is ready for the trial.", timeout=LIMIT_MS)
    expect(page.locator("#about")).to_contain_text("x 2 mm, y -1.5 mm, turned 3 degrees")
    expect(accept).to_be_disabled()  # before all has been looked at
    check_all(page)
    expect(other.locator("#text")).to_contain_text("The station is ready for the trial.")
    check_all(other)
    number = player.operator.describe()["question"]["number"]
    accept.click()
    refused = other.evaluate(
        "number => fetch('decide', {method: 'POST', body: JSON.stringify({number, decision: 'accept'})})"
        ".then(answer => answer.json())",
        number,
    )
    assert refused["error"] == "This was decided already (accept). Look at the page as it is now."
    expect(page.locator("#text")).to_contain_text("The peg hangs in free air.", timeout=LIMIT_MS)
    expect(page.locator("#measured")).to_contain_text("Zero of the force/torque sensor:")
    for camera in ("left", "right", "overview"):
        until(page, partial(page.locator(f"[data-camera={camera}] img").evaluate, "image => image.naturalWidth"))
    page.get_by_role("button", name="Grasp again").click()
    expect(page.locator("#question")).to_be_hidden()
    expect(page.locator("#text")).to_contain_text("The peg hangs in free air.", timeout=LIMIT_MS)
    expect(page.locator("#question")).to_be_visible(timeout=LIMIT_MS)
    page.get_by_label("Note").fill("The gel looks dry.")
    page.get_by_role("button", name="Write").click()
    expect(page.locator("#help")).to_contain_text("note, 0 s. The gel looks dry.")
    page.get_by_role("button", name="Pause").click()
    check_all(page)
    accept.click()
    expect(page.locator("#phase")).to_contain_text("Paused for")
    assert not trial.done()
    page.set_viewport_size({"width": PORTRAIT[0], "height": PORTRAIT[1]})
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    expect(page.locator("#stop")).to_be_in_viewport()
    page.get_by_role("button", name="Go on").click()
    (attempt,) = trial.result(60)
    assert attempt.outcome.counts
    assert [each.kind for each in attempt.help] == [HelpKind.REGRASP, HelpKind.NOTE, HelpKind.PAUSE]
    assert all(each.length_s > 0 for each in attempt.help if each.kind is not HelpKind.NOTE)

    stopped = begin(player)
    expect(page.locator("#question")).to_be_visible(timeout=LIMIT_MS)
    page.get_by_role("button", name="Stop").click()
    (attempt,) = stopped.result(60)
    assert (attempt.outcome, attempt.outcome.counts) == (TrialOutcome.STOPPED, False)
    expect(page.locator("#phase")).to_contain_text("An operator stopped it at the console.")
    expect(page.locator("#stop")).to_be_disabled()
    refused = begin(player)
    expect(page.locator("#text")).to_contain_text("Make the station safe, then release it.", timeout=LIMIT_MS)
    check_all(page)
    accept.click()
    expect(page.locator("#text")).to_contain_text("The station is ready", timeout=LIMIT_MS)
    page.get_by_role("button", name="Refuse").click()
    expect(page.locator("#alert")).to_have_text("Say in the note why the trial is refused.")
    page.get_by_label("Note").fill("A cable is loose.")
    page.get_by_role("button", name="Refuse").click()
    (attempt,) = refused.result(60)
    assert (attempt.outcome, attempt.reason) == (
        TrialOutcome.REFUSED,
        "An operator refused the trial: A cable is loose.",
    )
