"""What stands around the base in pictures."""

import gymnasium
import numpy as np
import pytest
from visible_scenes import STARTS, fusion_scene
from vitac.envs.vision.look import (
    LARGEST_CLUTTER,
    Look,
    colour_picture,
    depth_picture,
    draw_clutter,
    segmentation_picture,
    unit_normals,
)
from vitac.envs.vision.rasterizer import Label


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


def test_under_arena_2_a_table_and_a_wall_fill_the_picture_and_have_a_depth() -> None:
    options = {"start": (1.0, -2.0, 3.0, 5.0, 0), "rng_seed": (0, 3)}
    plain, arena = (
        gymnasium.make(
            "ViTac/FusionInsertion-v1", disable_env_checker=True, contact_model=model, depth_mode="gt"
        ).unwrapped
        for model in ("challenge-2025", "arena-2")
    )
    sights = []
    for env in (plain, arena):
        env.reset(options=options)
        sights.append(env._scene.sight())  # type: ignore[attr-defined]
    around = [np.isin(sight.segmentation, (Label.TABLE, Label.WALL)) for sight in sights]
    assert not around[0].any()
    assert (sights[1].segmentation == Label.NOTHING).sum() == 0
    assert (sights[1].depth_m > 0).all()
    assert 0.4 < around[1].mean() < 1
    objects = sights[1].objects
    assert objects.peg_seen
    assert objects.base_seen
    # The challenge's colour rule finds no point of table or wall.
    np.testing.assert_allclose(objects.points_m.mean(axis=1), sights[0].objects.points_m.mean(axis=1), atol=5e-3)


Start = tuple[float, float, float, float, int]


@pytest.mark.parametrize("start", STARTS)
def test_the_references_colour_rule_finds_peg_and_base_and_nothing_else(start: Start) -> None:
    """The challenge's colour rule: peg where R > 200, G < 100, B < 100; base where B > 200, G < 100."""
    scene = fusion_scene(start)
    view = scene.view()
    red, green, blue = np.moveaxis(colour_picture(view, scene.surfaces, scene.vertices_m), 2, 0)
    label = segmentation_picture(view, scene.surfaces)
    peg = (red > 200) & (green < 100) & (blue < 100)
    base = (blue > 200) & (green < 100)
    np.testing.assert_array_equal(peg, label == Label.PEG)
    np.testing.assert_array_equal(base, label == Label.BASE)


def test_colours_lie_in_the_ranges_of_the_challenges_pictures() -> None:
    """As in the challenge's pictures."""
    scene = fusion_scene(STARTS[0])
    view = scene.view()
    picture = colour_picture(view, scene.surfaces, scene.vertices_m)
    label = segmentation_picture(view, scene.surfaces)
    ranges = {
        Label.NOTHING: ((255, 255), (255, 255), (255, 255)),
        Label.BASE: ((16, 68), (16, 68), (255, 255)),
        Label.PEG: ((21, 255), (4, 71), (65, 255)),
        Label.LEFT_GEL: ((147, 160), (255, 255), (255, 255)),
        Label.RIGHT_GEL: ((147, 160), (255, 255), (255, 255)),
    }
    for name, channels in ranges.items():
        found = picture[label == name]
        assert len(found) > 200
        for channel, (low, high) in enumerate(channels):
            assert low <= found[:, channel].min() <= found[:, channel].max() <= high


def test_the_two_front_faces_of_the_hexagon_differ_and_those_of_the_cuboid_are_one() -> None:
    def greens(hexagon: int) -> int:
        scene = fusion_scene((0.0, 0.0, 0.0, 6.0, hexagon))
        view = scene.view()
        picture = colour_picture(view, scene.surfaces, scene.vertices_m)
        peg = picture[segmentation_picture(view, scene.surfaces) == Label.PEG][:, 1]
        _, counts = np.unique(peg, return_counts=True)
        return int((counts > 300).sum())

    # The peg's top face is the further one.
    assert (greens(1), greens(0)) == (3, 2)


def test_depth_is_zero_where_nothing_is_seen() -> None:
    scene = fusion_scene(STARTS[3])
    view = scene.view()
    depth_m, label = depth_picture(view), segmentation_picture(view, scene.surfaces)
    assert depth_m.dtype == np.float32
    np.testing.assert_array_equal(depth_m == 0.0, label == Label.NOTHING)
    assert depth_m[label != Label.NOTHING] == pytest.approx(view.depth_m[label != Label.NOTHING], abs=4e-8)


def test_unit_normals_point_outwards() -> None:
    """Over a convex body, away from its centre."""
    scene = fusion_scene(STARTS[0])
    peg = scene.surfaces.triangles[scene.surfaces.labels == Label.PEG]
    normals = unit_normals(scene.vertices_m, peg)
    middles = scene.vertices_m[peg].mean(axis=1)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(peg)))
    assert ((middles - scene.vertices_m[np.unique(peg)].mean(axis=0)) * normals).sum(axis=1).min() > 0


def test_turned_hues_hide_peg_and_base_from_the_colour_rule_and_nothing_else_changes() -> None:
    scene = fusion_scene(STARTS[0])
    view = scene.view()
    plain = colour_picture(view, scene.surfaces, scene.vertices_m)
    turned = colour_picture(view, scene.surfaces, scene.vertices_m, Look(peg_hue_deg=120.0, base_hue_deg=120.0))
    label = segmentation_picture(view, scene.surfaces)
    green = turned[label == Label.PEG]
    assert (green[:, 1] > green[:, [0, 2]].max(axis=1)).all()
    assert (turned[label == Label.BASE][:, 0] > 200).all()
    others = np.isin(label, (Label.NOTHING, Label.LEFT_GEL, Label.RIGHT_GEL))
    np.testing.assert_array_equal(turned[others], plain[others])


def test_brightness_dims_all_and_the_light_moves_what_is_bright() -> None:
    scene = fusion_scene(STARTS[0])
    view = scene.view()
    plain, dim, other = (
        colour_picture(view, scene.surfaces, scene.vertices_m, look).astype(int)
        for look in (Look(), Look(brightness=0.5), Look(light_deg=120.0))
    )
    assert np.abs(dim - 0.5 * plain).max() <= 1.0
    assert (other != plain).any()
