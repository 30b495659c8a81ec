"""The challenge's tracker: on rendered pictures with known truth, and its rules on markers that a test places."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from vitac.station.perception.markers import AssignedMarkerTracker, MarkerFlow, MarkerTracker
from vitac.station.twin.gel_view import SMALL_CAMERA, Press, PressedGel

PICTURE = np.zeros((14, 14, 3), np.uint8)
APART = np.array([[50.0, 50.0], [100.0, 50.0], [150.0, 50.0]])
Tracker = MarkerTracker | AssignedMarkerTracker


class Placed:
    """Finds the markers that a test has placed."""

    def __init__(self) -> None:
        self.markers_px = APART

    def __call__(self, _: np.ndarray) -> np.ndarray:
        return self.markers_px.copy()


@pytest.fixture
def placed() -> Placed:
    return Placed()


@pytest.fixture
def tracker(placed: Placed) -> MarkerTracker:
    """A tracker that has dropped the first pictures and started on three markers."""
    made = MarkerTracker(find=placed)
    assert [made.see(PICTURE) for _ in range(10)] == [None] * 10
    made.see(PICTURE)
    return made


def see(tracker: MarkerTracker, placed: Placed, *markers_px: tuple[float, float]) -> MarkerFlow:
    placed.markers_px = np.array(markers_px).reshape(-1, 2)
    flow = tracker.see(PICTURE)
    assert flow is not None
    return flow


def followed(gel: PressedGel, tracker: Tracker) -> Iterator[tuple[MarkerFlow, np.ndarray, np.ndarray]]:
    """Yield flow, true reference and true positions of the markers in it."""
    rest = None
    for picture, truth in gel.pictures():
        flow = tracker.see(picture)
        if flow is not None:
            rest = truth if rest is None else rest
            nearest = np.linalg.norm(flow.reference[:, None] - rest[None], axis=2).argmin(axis=1)
            yield flow, rest[nearest], truth[nearest]


@pytest.mark.parametrize("make", [MarkerTracker, AssignedMarkerTracker])
@pytest.mark.parametrize(
    "press", [Press(shear_px=(25, -12), still=11, pictures=24), Press(twist_rad=0.2, still=11, pictures=24)]
)
def test_follows_every_marker_of_a_pressed_gel(make: Callable[[], Tracker], press: Press) -> None:
    flows = list(followed(PressedGel(press=press, camera=SMALL_CAMERA), make()))
    assert [len(flow.current) for flow, _, _ in flows] == [63] * 14
    errors = np.concatenate([np.linalg.norm(flow.current - truth, axis=1) for flow, _, truth in flows])
    assert np.median(errors) < 0.2
    assert errors.max() < 0.7
    moved = max(flow.largest_movement_px() for flow, _, _ in flows)
    assert moved == pytest.approx(max(np.hypot(*(truth - rest).T).max() for _, rest, truth in flows), abs=0.7)


def test_markers_are_followed_from_picture_to_picture(tracker: MarkerTracker, placed: Placed) -> None:
    for shift in (20.0, 40.0, 60.0):
        flow = see(tracker, placed, *((u + shift, v) for u, v in APART))
    assert flow.reference.tolist() == APART.tolist()
    assert (flow.current - flow.reference).tolist() == [[60.0, 0.0]] * 3


def test_marker_that_jumps_too_far_is_lost_and_stays_lost(tracker: MarkerTracker, placed: Placed) -> None:
    assert len(see(tracker, placed, (50, 50), (100, 81.25), (150, 50)).current) == 3
    flow = see(tracker, placed, (50, 50), (100, 112.6), (150, 50))
    assert flow.reference[:, 0].tolist() == [50.0, 150.0]
    assert len(see(tracker, placed, (50, 50), (100, 81.25), (150, 50)).current) == 2


def test_of_two_that_want_the_same_the_farther_is_lost(tracker: MarkerTracker, placed: Placed) -> None:
    flow = see(tracker, placed, (74, 50), (150, 50))
    assert flow.reference.tolist() == [[50.0, 50.0], [150.0, 50.0]]
    assert flow.current.tolist() == [[74.0, 50.0], [150.0, 50.0]]


def test_all_are_lost_where_no_marker_is_found(tracker: MarkerTracker, placed: Placed) -> None:
    flow = see(tracker, placed)
    assert (len(flow.current), flow.is_contact(), flow.is_over_force()) == (0, False, False)
    assert len(see(tracker, placed, *map(tuple, APART)).current) == 0


def test_starts_again_after_ten_pictures_without_contact(tracker: MarkerTracker, placed: Placed) -> None:
    drifted = [(u + 0.4, v) for u, v in APART]
    for _ in range(9):  # with the first picture it is the tenth
        assert see(tracker, placed, *drifted).reference.tolist() == APART.tolist()
    flow = see(tracker, placed, *drifted)
    assert flow.reference.tolist() == flow.current.tolist() == [list(each) for each in drifted]


def test_does_not_start_again_in_contact(tracker: MarkerTracker, placed: Placed) -> None:
    moved = [(u + 0.6, v) for u, v in APART]
    for _ in range(30):
        flow = see(tracker, placed, *moved)
    assert flow.reference.tolist() == APART.tolist()
    assert flow.is_contact()


def test_starts_again_on_request(tracker: MarkerTracker, placed: Placed) -> None:
    see(tracker, placed, (60, 50))
    tracker.start_again()
    flow = see(tracker, placed, (60, 50), (90, 70))
    assert flow.reference.tolist() == flow.current.tolist() == [[60.0, 50.0], [90.0, 70.0]]


@pytest.mark.parametrize(
    ("movement_px", "is_contact", "is_over_force"),
    [(0.5, False, False), (0.6, True, False), (30.0, True, False), (30.1, True, True)],
)
def test_contact_and_over_force_follow_the_largest_movement(
    tracker: MarkerTracker, placed: Placed, movement_px: float, is_contact: bool, is_over_force: bool
) -> None:
    flow = see(tracker, placed, (50, 50), (100, 50 - movement_px), (150, 50))
    assert (flow.is_contact(), flow.is_over_force()) == (is_contact, is_over_force)
