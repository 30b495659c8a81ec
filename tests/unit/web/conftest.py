import pytest
from asgi_browser import AsgiBrowser
from page_service import FixedData, an_application
from visits import BEARS, BOTH, COMPLETED, FAILED, GELBOTS, ORGANIZERS, QUEUED, RUNNING


@pytest.fixture
def data() -> FixedData:
    return FixedData(visitors=[GELBOTS, BEARS, ORGANIZERS], found=[RUNNING, COMPLETED, BOTH, FAILED, QUEUED])


@pytest.fixture
def browser(data: FixedData) -> AsgiBrowser:
    return AsgiBrowser(an_application(data))
