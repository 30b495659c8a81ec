"""For every test: a clean environment, where the challenge's own files are, and how long it took."""

import csv
import gc
import os
import sys
import warnings
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from shared_simulation import SharedProcesses

REPOSITORY = Path(__file__).resolve().parent.parent
MACHINE_VARIABLES = {
    *("VITAC_BWRAP", "VITAC_CACHE_DIR", "VITAC_CHROMIUM", "VITAC_EXPECT_WHEEL", "VITAC_REFERENCE_DIR"),
    "VITAC_TEST_COMPOSE",
}
ALLOCATIONS_PER_COLLECTION = 5_000
"""Python's own is 700, with which collections of all objects come ten times as often as they find much."""

settings.register_profile("new examples", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("any machine", settings.get_profile("new examples"), derandomize=True)


def pytest_configure(config: pytest.Config) -> None:
    """Forgets the caller's settings: a test must never reach the database or service that somebody works with.

    Bytecode is kept, whatever the caller says: hundreds of processes are started, and each would compile it all anew.
    No example of Hypothesis fails because it took long: that says how busy the machine is. Nor does a change fail for
    examples that nobody saw before: they are the same every time, unless `--hypothesis-profile` asks for new ones.
    """
    if config.getoption("--hypothesis-profile") is None:
        settings.load_profile("any machine")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    for name in [name for name in os.environ if name.startswith("VITAC_") and name not in MACHINE_VARIABLES]:
        del os.environ[name]
    os.environ["VITAC_SANDBOX_FILES"] = "disk"  # but where a test is about memory: half a gigabyte is copied there


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for garbage not at all while modules and 9,000 tests are loaded, and later rarely and not among them.

    They stay until the end. Looking as often as usual took a fifth of their collection and a tenth of the tests.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(ALLOCATIONS_PER_COLLECTION)
        gc.enable()


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Three processes for the suite on two cores, since tests often wait, and four with the slow ones, which wait more.

    None for tests that were named or chosen.
    """
    chosen = getattr(config.option, "file_or_dir", None) or config.option.keyword  # there are none with --help
    waiting = 2 if config.option.markexpr else 1
    return 0 if chosen else min(2, os.cpu_count() or 1) + waiting


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave slow tests out of the whole suite; they run where tests are chosen by file, keyword or marker, as in CI.

    Those that take minutes begin first, so that none of them runs alone at the end, then those of the worker, which
    wait half of the time while others compute.
    """

    def place(item: pytest.Item) -> tuple[int, bool]:
        minutes = max((mark.kwargs.get("minutes", 0) for mark in item.iter_markers("slow")), default=0)
        return -minutes, not item.nodeid.startswith("tests/unit/worker/")

    items.sort(key=place)
    option = config.option
    if option.file_or_dir or option.keyword or option.markexpr:
        return
    config.hook.pytest_deselected(items=[item for item in items if item.get_closest_marker("slow")])
    items[:] = [item for item in items if not item.get_closest_marker("slow")]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the option that keeps durations."""
    help_text = "write how long set-up, call and tear-down of each test took, the longest first"
    parser.addoption("--durations-csv", type=Path, metavar="FILE", help=help_text)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Keeps and sums up the durations where they were asked for."""
    if (path := config.getoption("--durations-csv")) is None:
        return
    found = [report for some in terminalreporter.stats.values() for report in some]
    reports = [report for report in found if isinstance(report, pytest.TestReport)]
    reports.sort(key=lambda report: -report.duration)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["seconds", "phase", "test"])
        rows.writerows((f"{report.duration:.3f}", report.when, report.nodeid) for report in reports)
    sums = {when: sum(r.duration for r in reports if r.when == when) for when in ("setup", "call", "teardown")}
    terminalreporter.write_line(", ".join(f"{when} {seconds:.0f} s" for when, seconds in sums.items()) + f": {path}")


@pytest.fixture(scope="session")
def repository() -> Path:
    """The repository's root, for tests of its files (locks, packaging, documents)."""
    return REPOSITORY


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    """The folder with the challenge's numbers, logs and assets, from VITAC_REFERENCE_DIR or beside the repository."""
    folder = Path(os.environ.get("VITAC_REFERENCE_DIR") or REPOSITORY.parent / "shared" / "reference")
    if not folder.is_dir():
        pytest.skip(f"no reference folder at {folder} (set VITAC_REFERENCE_DIR to compare with the challenge's files)")
    return folder


@pytest.fixture(scope="module")
def loaded_simulation() -> Iterator["SharedProcesses"]:
    """Processes of shards for all tests of a file; `shared_simulation` has evaluations use them."""
    from shared_simulation import loaded_once  # late: few tests need it, and it imports the evaluator

    with loaded_once() as processes:
        yield processes


@pytest.fixture
def shared_simulation(loaded_simulation: "SharedProcesses", monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the evaluations of a file's tests share one process that has the simulation loaded."""
    from shared_simulation import evaluate_with

    evaluate_with(loaded_simulation, monkeypatch)


@pytest.fixture
def without_earlier_garbage() -> None:
    """Let go of what earlier tests of this process left open, before a test that looks for its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gc.collect()
