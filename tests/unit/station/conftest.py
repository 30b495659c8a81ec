from collections.abc import Iterator

import pytest
from twin_station import TwinStation, twin_station


@pytest.fixture
def twins() -> Iterator[TwinStation]:
    with twin_station() as station:
        yield station
