import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.drawing.projection.shading import averaged, lit, seen_through

TOWARDS_LIGHT = np.array([0.30, 0.78, -0.55])


def unit(x: float, y: float, z: float) -> np.ndarray:
    return np.asarray(np.array([[x, y, z]]) / np.linalg.norm([x, y, z]))


def test_a_face_towards_the_light_keeps_its_colour_and_one_away_from_it_is_darker() -> None:
    grey = np.array([0.8, 0.6, 0.4])
    assert lit(grey, unit(*TOWARDS_LIGHT)) == pytest.approx(grey[None], rel=0.01)
    assert lit(grey, unit(*-TOWARDS_LIGHT)) == pytest.approx(0.72 * grey[None])
    assert lit(grey, unit(*-TOWARDS_LIGHT), matt=False) == pytest.approx(0.88 * grey[None])


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_light_never_leaves_the_range_of_colours_nor_changes_their_hue(normal: tuple[float, float, float]) -> None:
    colour = np.array([1.0, 0.5, 0.25])
    for matt in (True, False):
        found = lit(colour, unit(*normal), matt=matt)[0]
        assert 0.7 <= found[0] <= 1.0
        assert found / found[0] == pytest.approx(colour)


def test_each_face_may_have_its_own_colour() -> None:
    colours = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    normals = np.concatenate([unit(0.0, 0.0, 1.0), unit(*TOWARDS_LIGHT)])
    both = lit(colours, normals)
    for index in range(2):
        np.testing.assert_array_equal(both[index], lit(colours[index], normals[index : index + 1])[0])


def test_glass_is_mixed_in_only_where_it_is() -> None:
    glass, behind = np.ones((2, 3, 3)), np.zeros((2, 3, 3))
    is_glass = np.array([[True, False, False], [False, False, True]])
    mixed = seen_through(glass, behind, is_glass)
    assert mixed[is_glass] == pytest.approx(0.34)
    assert (mixed[~is_glass] == 0.0).all()
    assert (behind == 0.0).all(), "the picture behind is not changed"


def test_a_picture_seen_through_itself_is_itself() -> None:
    picture = np.random.default_rng(0).random((4, 5, 3))
    assert seen_through(picture, picture, np.ones((4, 5), dtype=bool)) == pytest.approx(picture)


@pytest.mark.parametrize("block", [1, 2, 3])
def test_blocks_are_averaged_and_the_mean_is_kept(block: int) -> None:
    picture = np.random.default_rng(block).random((6, 12, 3))
    small = averaged(picture, block)
    assert small.shape == (6 // block, 12 // block, 3)
    assert small.mean(axis=(0, 1)) == pytest.approx(picture.mean(axis=(0, 1)))
    assert small[0, -1] == pytest.approx(picture[:block, 12 - block :].mean(axis=(0, 1)))
