from collections.abc import Iterator

import pytest
from asgi_browser import AsgiBrowser
from seeded_site import SeededSite, SharedSite


@pytest.fixture(scope="session")
def shared_site() -> Iterator[SharedSite]:
    with SharedSite() as shared:
        yield shared


@pytest.fixture
def site(shared_site: SharedSite) -> Iterator[SeededSite]:
    """A service with content; a test may change it."""
    with shared_site.visited() as site:
        yield site


@pytest.fixture
def browser(site: SeededSite) -> AsgiBrowser:
    """Somebody who is not signed in."""
    return site.visitor()
