"""What stands around the base in pictures."""

import numpy as np
import pytest
from vitac.envs.vision.look import LARGEST_CLUTTER, Look, draw_clutter
from vitac.envs.vision.surfaces import Label


def test_clutter_is_closed_stands_on_the_ground_and_leaves_the_base_free() -> None:
    boxes = draw_clutter(Look(clutter=LARGEST_CLUTTER), np.random.default_rng(5))
    assert len(boxes) == LARGEST_CLUTTER
    for box, _ in boxes:
        x, y, z = box.vertices_m.T * 1e3
        assert z.min() == pytest.approx(-2.5)
        assert x.min() > 37.5 or y.max() < -22.5 or y.min() > 67.5
        corners = box.vertices_m[box.triangles]
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
        assert volume > 0
    assert {label for _, label in boxes} == {Label.CLUTTER_OF_BASE, Label.CLUTTER_OF_PEG}


def test_fewer_boxes_are_the_first_of_more() -> None:
    few, many = (draw_clutter(Look(clutter=count), np.random.default_rng(5)) for count in (2.9, 6.0))
    assert len(few) == 2
    for (box, label), (other, as_other) in zip(few, many, strict=False):
        assert np.array_equal(box.vertices_m, other.vertices_m)
        assert label is as_other
