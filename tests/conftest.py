"""For every test: a clean environment, and where the challenge's own files are."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
MACHINE_VARIABLES = {"VITAC_BWRAP", "VITAC_CACHE_DIR", "VITAC_CHROMIUM", "VITAC_EXPECT_WHEEL", "VITAC_REFERENCE_DIR"}


def pytest_configure() -> None:
    """Forgets the caller's settings: a test must never reach the database or service that somebody works with."""
    for name in [name for name in os.environ if name.startswith("VITAC_") and name not in MACHINE_VARIABLES]:
        del os.environ[name]


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two processes for the whole suite, which was written for two cores; none for tests that were named or chosen."""
    chosen = config.option.file_or_dir or config.option.keyword
    return 0 if chosen else min(2, os.cpu_count() or 1)


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
