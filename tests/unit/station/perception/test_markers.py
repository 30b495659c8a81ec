"""Finding markers in rendered pictures, and the numbers of the challenge that decide which dots are markers."""

import numpy as np
import pytest
from vitac.station.perception import markers
from vitac.station.perception.markers import cut_picture, find_centres, find_markers
from vitac.station.twin.gel_view import marker_grid
from vitac.station.twin.pictures import GelCamera

CAMERAS = [GelCamera(), GelCamera(width=800, height=600), GelCamera(defocus_px=2.0, noise=5.0)]


def rendered(camera: GelCamera, markers_px: np.ndarray, seed: int = 1) -> np.ndarray:
    return cut_picture(camera.picture(markers_px, np.random.default_rng(seed)))


@pytest.mark.parametrize("camera", CAMERAS)
def test_all_markers_are_found_where_they_are(camera: GelCamera) -> None:
    grid = marker_grid()
    picture = rendered(camera, grid)
    assert picture.shape == (240, 320, 3)
    for centres in (find_markers(picture), find_centres(picture)):
        assert len(centres) == len(grid)
        distances = np.linalg.norm(centres[:, None] - grid[None], axis=2)
        assert sorted(distances.argmin(axis=1)) == list(range(len(grid)))
        assert distances.min(axis=1).max() < 0.5


def test_gel_without_markers_has_none() -> None:
    picture = rendered(GelCamera(), np.empty((0, 2)))
    assert find_markers(picture).shape == (0, 2)
    assert find_centres(picture).shape == (0, 2)


@pytest.mark.parametrize(("radius_px", "found"), [(0.8, 0), (4.0, 1), (14.0, 0)])
def test_specks_and_blotches_are_no_markers(radius_px: float, found: int) -> None:
    picture = rendered(GelCamera(marker_radius_px=radius_px), np.array([[160.0, 120.0]]))
    assert len(find_markers(picture)) == found


def test_border_of_a_seventh_and_two_rows_more_at_the_top_are_cut_off() -> None:
    picture = np.zeros((490, 700, 3), np.uint8)
    picture[72:420, 100:600] = 200
    assert cut_picture(picture).min() == 200
    picture[71, 300] = 0
    picture[420, 300] = 0
    assert cut_picture(picture).min() == 200
    picture[72, 300] = 0
    assert cut_picture(picture).min() < 200


def test_fewer_thresholds_give_the_blobs_of_all_that_the_challenge_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    picture = rendered(GelCamera(noise=5.0), marker_grid())
    found = find_markers(picture)
    with monkeypatch.context() as patch:
        patch.setattr(markers, "_THRESHOLDS", (1.0, 20.0, 0.5))
        markers._detector.cache_clear()
        of_all = find_markers(picture)
    markers._detector.cache_clear()
    np.testing.assert_allclose(found, of_all, atol=1e-4)
