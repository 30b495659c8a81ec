"""The object at a prompt: on rendered pictures of the fusion task with known truth, and on pictures made by hand."""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from visible_scenes import STARTS, fusion_scene
from vitac.envs.vision.camera import DepthMode, Sight
from vitac.envs.vision.rasterizer import Label
from vitac.station.devices.cameras import ColourDepth, ColourIntrinsics
from vitac.station.perception.segmentation import NothingAtPrompt, SamMissing, make_segmenter, object_points_m, segment

INTRINSICS = ColourIntrinsics(width=60, height=40, fx=50.0, fy=50.0, cx=30.0, cy=20.0)
RED, BLUE = (40, 40, 200), (200, 40, 40)


def two_squares(
    *, colours: tuple[tuple[int, int, int], tuple[int, int, int]], depths_m: tuple[float, float]
) -> ColourDepth:
    """Two squares side by side that touch, before nothing."""
    colour, depth_m = np.full((40, 60, 3), 255, np.uint8), np.zeros((40, 60), np.float32)
    for column, each, far_m in zip((10, 30), colours, depths_m, strict=True):
        colour[10:30, column : column + 20], depth_m[10:30, column : column + 20] = each, far_m
    return ColourDepth(colour=colour, depth_m=depth_m)


def columns_of(mask: np.ndarray) -> tuple[int, int]:
    columns = np.flatnonzero(mask.any(axis=0))
    return int(columns[0]), int(columns[-1])


@pytest.mark.parametrize(("depth_mode", "least"), [(DepthMode.GT, 0.97), (DepthMode.STEREO, 0.8)])
@pytest.mark.parametrize("label", [Label.PEG, Label.BASE])
def test_finds_peg_and_base_from_a_prompt_near_their_middle(depth_mode: DepthMode, least: float, label: Label) -> None:
    generator = np.random.default_rng(1)
    scene = fusion_scene(STARTS[4])
    sight = Sight(scene.surfaces, scene.vertices_m, pose=scene.pose, depth_mode=depth_mode, random=generator)
    noisy = sight.colours + 4 * generator.standard_normal(sight.colours.shape)
    seen = ColourDepth(colour=np.clip(noisy, 0, 255).astype(np.uint8)[:, :, ::-1].copy(), depth_m=sight.depth_m)
    truth = sight.segmentation == label
    rows, columns = np.nonzero(truth)
    middle = np.argmin((columns - columns.mean()) ** 2 + (rows - rows.mean()) ** 2)
    found = segment(seen, (int(columns[middle]), int(rows[middle])))
    assert (found & truth).sum() / (found | truth).sum() > least


@pytest.mark.parametrize(
    ("colours", "depths_m"), [((RED, BLUE), (0.4, 0.4)), ((RED, RED), (0.4, 0.42)), ((RED, RED), (0.4, 0.6))]
)
def test_ends_where_colour_or_depth_does(
    colours: tuple[tuple[int, int, int], tuple[int, int, int]], depths_m: tuple[float, float]
) -> None:
    seen = two_squares(colours=colours, depths_m=depths_m)
    assert columns_of(segment(seen, (20, 20))) == (10, 29)
    assert columns_of(segment(seen, (40, 20))) == (30, 49)


def test_continues_where_neither_ends() -> None:
    assert columns_of(segment(two_squares(colours=(RED, RED), depths_m=(0.4, 0.405)), (20, 20))) == (10, 49)


@pytest.mark.parametrize(
    ("prompt_px", "sentence"),
    [
        ((60, 20), r"The prompt \(60, 20\) is outside of the picture of 60 x 40 pixels"),
        ((-1, 20), "is outside"),
        ((3, 3), r"No depth is known at the prompt \(3, 3\)"),
    ],
)
def test_prompt_on_nothing_is_refused(prompt_px: tuple[int, int], sentence: str) -> None:
    with pytest.raises(NothingAtPrompt, match=sentence):
        segment(two_squares(colours=(RED, BLUE), depths_m=(0.4, 0.5)), prompt_px)


def test_points_lie_on_the_object() -> None:
    seen = two_squares(colours=(RED, BLUE), depths_m=(0.4, 0.5))
    points_m = object_points_m(segment(seen, (40, 20)), seen.depth_m, INTRINSICS, np.random.default_rng(1))
    assert points_m.shape == (128, 3)
    assert (points_m[:, 2] == np.float32(0.5)).all()
    assert points_m[:, 0].min() >= 0.5 * (30 - 30) / 50
    assert points_m[:, 0].max() <= 0.5 * (50 - 30) / 50
    with pytest.raises(NothingAtPrompt, match="no pixel with a depth"):
        object_points_m(np.zeros((40, 60), bool), seen.depth_m, INTRINSICS, np.random.default_rng(1))


def test_sam_embeds_a_picture_once_and_its_best_mask_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in of SAM, as its weights cannot be had here; what it is asked for is what the package takes."""
    seen = two_squares(colours=(RED, BLUE), depths_m=(0.4, 0.5))
    asked: list[Any] = []

    class Predictor:
        def __init__(self, model: str) -> None:
            asked.append(model)

        def set_image(self, picture: np.ndarray, image_format: str) -> None:
            asked.append((picture is seen.colour, image_format))

        def predict(self, points: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray, None]:
            asked.append((points.tolist(), labels.tolist()))
            return (
                np.array([np.zeros((40, 60)), np.ones((40, 60)), np.zeros((40, 60))]),
                np.array([0.2, 0.9, 0.4]),
                None,
            )

    registry = {"vit_b": lambda checkpoint: Path(checkpoint).read_text()}
    monkeypatch.setitem(
        sys.modules, "segment_anything", SimpleNamespace(SamPredictor=Predictor, sam_model_registry=registry)
    )
    (tmp_path / "sam_vit_b.pth").write_text("weights")
    find = make_segmenter(tmp_path / "sam_vit_b.pth")
    assert find(seen, (20, 20)).all()
    assert find(seen, (40, 20)).dtype == bool
    assert asked == ["weights", (True, "BGR"), ([[20, 20]], [1]), ([[40, 20]], [1])]


def test_sam_is_asked_for_by_its_weights_and_what_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert make_segmenter(None) is segment
    weights = tmp_path / "sam_vit_b.pth"
    with pytest.raises(SamMissing, match="Expected the weights of SAM at"):
        make_segmenter(weights)
    weights.touch()
    monkeypatch.setitem(sys.modules, "segment_anything", None)
    with pytest.raises(SamMissing, match="Expected the package segment-anything"):
        make_segmenter(weights)
