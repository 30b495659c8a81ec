"""One thread that looks, and all that listen to it; twins of cameras are elsewhere, these pictures a test places."""

from collections.abc import Iterator
from itertools import chain, repeat
from typing import Any

import numpy as np
import pytest
from vitac.station.devices.stage import DeviceFault
from vitac.station.eyes import Eyes, Finger
from vitac.station.guard import StopCause
from vitac.station.perception.markers import DROPPED_PICTURES
from vitac.station.twin.gel_view import SMALL_CAMERA, marker_grid

Picture = np.ndarray


def picture(*, torn: bool = False, moved_px: float = 0.0) -> Picture:
    taken = SMALL_CAMERA.picture(marker_grid() + moved_px, np.random.default_rng(1))
    if torn:
        taken[100:220, 200:330] //= 5
    return taken


class Camera:
    """Sends pictures, then the last one again and again; or fails after them."""

    def __init__(self, *pictures: Picture, fails: bool = False) -> None:
        self.pictures: Iterator[Picture] = chain(pictures, () if fails else repeat(pictures[-1]))

    def read(self) -> Picture:
        for each in self.pictures:
            return each
        raise DeviceFault("The camera stopped sending.")


class Guarded:
    """Notes why it was stopped."""

    def __init__(self) -> None:
        self.reasons, self.seen = list[str](), 0
        self.stop = lambda reason, *, cause: self.reasons.append(reason) if cause is StopCause.FAULT else None

    def beat(self) -> None:
        """It is alive."""

    def see_markers(self, _: np.ndarray) -> None:
        self.seen += 1


def eyes(left: Any, right: Any, guard: Any = None) -> Eyes:
    return Eyes(left=left, right=right, guard=guard)


def test_all_listeners_get_everything_that_is_seen() -> None:
    still, moved = picture(), picture(moved_px=3.0)
    left = Camera(*[still] * (DROPPED_PICTURES + 1), moved, fails=True)
    looking = eyes(left, Camera(still))
    listeners = [looking.sights() for _ in range(2)]
    with looking:
        seen = [[next(listener).movement_px()[0] for _ in range(2)] for listener in listeners]
    assert seen == [[0.0, pytest.approx(3 * 2**0.5, abs=0.1)]] * 2
    for listener in (*listeners, looking.sights()):
        with pytest.raises(DeviceFault, match="stopped sending"):
            next(listener)


def test_damaged_gel_stops_the_station_and_names_the_side() -> None:
    guard = Guarded()
    still, torn = picture(), picture(torn=True)
    right = Camera(*[still] * (DROPPED_PICTURES + 2), torn)
    with eyes(Camera(still), right, guard) as looking:
        looking.wait(4)
    assert guard.reasons
    assert set(guard.reasons) == {guard.reasons[0]}
    assert guard.reasons[0].startswith("The right gel is damaged or covered: ")
    assert guard.seen > 0


def test_tracker_of_one_side_starts_again() -> None:
    still, moved = picture(), picture(moved_px=2.0)
    pictures = [still] * (DROPPED_PICTURES + 1) + [moved]
    with eyes(Camera(*pictures), Camera(*pictures)) as looking:
        looking.wait(3)
        looking.restart_trackers(Finger.LEFT)
        assert looking.see().movement_px() == pytest.approx((0.0, 2 * 2**0.5), abs=0.1)
