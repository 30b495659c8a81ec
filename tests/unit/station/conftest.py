from collections.abc import Iterator

import pytest
from vitac.station.twin.laboratory import TwinStation, twin_station


@pytest.fixture
def twins() -> Iterator[TwinStation]:
    """Twins that send pictures without a pause, and may be slow with forces."""
    with twin_station(picture_period_s=0.001) as station:
        station.description["limits"]["reading_s"] = 5.0
        yield station
