"""Finds the object at a point of an RGB-D picture, without a network: as far as colour and depth are continuous.

The challenge prompts SAM at the centres of peg and hole; its weights cannot be delivered, so this takes its place where
none are given.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from pickle import UnpicklingError
from typing import Final

import numpy as np
from numpy.typing import NDArray
from vitac.envs.vision.optics import rays
from vitac.errors import VitacError

from ..devices.cameras import ColourDepth, ColourIntrinsics

Mask = NDArray[np.bool_]

_NEARBY_PX: Final = 2
"""The prompt's colour and depth are medians over a square that reaches this far."""
POINTS: Final = 128


class NothingAtPrompt(VitacError):
    """A prompt is outside of the picture or where no depth is known; prompt elsewhere on the object."""


_LARGEST_COLOUR: Final = 25.0
"""Distance of an object's a and b from the prompt's, of CIE Lab as OpenCV scales it to 0 to 255."""
_LARGEST_STEP_M: Final = 0.008
"""Difference of depth between neighbours on an object."""
_REACH_M: Final = 0.1
"""Largest difference of an object's depth from the prompt's."""


def segment(seen: ColourDepth, prompt_px: tuple[int, int]) -> Mask:
    """Return the pixels of the object at a prompt, shape [height, width].

    Args:
        seen: aligned colour and depth.
        prompt_px: u and v of a pixel on the object.

    Raises:
        NothingAtPrompt: naming what is missing there.
    """
    import cv2

    nearby = _nearby(seen.depth_m.shape, prompt_px)
    depths_m = seen.depth_m[nearby]
    if not (depths_m > 0).any():
        raise NothingAtPrompt(f"No depth is known at the prompt {prompt_px}. Prompt elsewhere on the object.")
    depth_m = float(np.median(depths_m[depths_m > 0]))
    chroma = cv2.cvtColor(seen.colour, cv2.COLOR_BGR2LAB)[:, :, 1:].astype(np.float32)
    distance = np.linalg.norm(chroma - np.median(chroma[nearby].reshape(-1, 2), axis=0), axis=2)
    is_like = (distance <= _LARGEST_COLOUR) & (np.abs(seen.depth_m - depth_m) <= _REACH_M)
    return _connected(is_like & (seen.depth_m > 0), seen.depth_m, prompt_px, _LARGEST_STEP_M)


class SamMissing(VitacError):
    """SAM cannot be loaded; the message says what is missing."""


Segmenter = Callable[[ColourDepth, tuple[int, int]], Mask]


@cache
def make_segmenter(weights: Path | None) -> Segmenter:
    """Return what finds the object at a prompt: `segment`, or SAM (ViT-B) where its weights are given, loaded once.

    Raises:
        SamMissing: the package or the file of weights.
    """
    if weights is None:
        return segment
    if not weights.is_file():
        raise SamMissing(f"Expected the weights of SAM at {weights}, got no file. Correct `sam_weights`, or remove it.")
    try:
        from segment_anything import SamPredictor, sam_model_registry  # type: ignore[import-not-found]
    except ImportError as error:
        raise SamMissing(f"Expected the package segment-anything for `sam_weights`: {error}. Install it.") from error
    try:
        predictor = SamPredictor(sam_model_registry["vit_b"](checkpoint=str(weights)))
    except (RuntimeError, EOFError, UnpicklingError) as error:
        raise SamMissing(f"Expected the weights of SAM (ViT-B) in {weights}: {error!s:.200}") from error
    embedded: ColourDepth | None = None

    def segment_by_network(seen: ColourDepth, prompt_px: tuple[int, int]) -> Mask:
        nonlocal embedded
        if seen is not embedded:  # one picture has several prompts
            predictor.set_image(seen.colour, "BGR")
            embedded = seen
        masks, scores, _ = predictor.predict(np.array([prompt_px]), np.ones(1, dtype=int))
        return np.asarray(masks[int(np.argmax(scores))], dtype=bool)

    return segment_by_network


def object_points_m(
    mask: Mask, depth_m: NDArray[np.float32], intrinsics: ColourIntrinsics, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Return 128 points of an object in the camera's frame, drawn with replacement, shape [128, 3] [m].

    Raises:
        NothingAtPrompt: the mask has no pixel with a depth.
    """
    rows, columns = np.nonzero(mask & (depth_m > 0))
    if not len(rows):
        raise NothingAtPrompt("The mask has no pixel with a depth. Prompt elsewhere on the object.")
    chosen = generator.choice(len(rows), POINTS)
    x, y = rays(columns[chosen], rows[chosen], (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy))
    z = depth_m[rows[chosen], columns[chosen]]
    return np.stack((x * z, y * z, z), axis=1).astype(np.float32)


def _nearby(shape: tuple[int, ...], prompt_px: tuple[int, int]) -> tuple[slice, slice]:
    u, v = prompt_px
    height, width = shape
    if not (0 <= u < width and 0 <= v < height):
        raise NothingAtPrompt(f"The prompt {prompt_px} is outside of the picture of {width} x {height} pixels.")
    rows = slice(max(v - _NEARBY_PX, 0), v + _NEARBY_PX + 1)
    return rows, slice(max(u - _NEARBY_PX, 0), u + _NEARBY_PX + 1)


def _connected(allowed: Mask, depth_m: NDArray[np.float32], prompt_px: tuple[int, int], step_m: float) -> Mask:
    """Return what is reached from the allowed pixel nearest to the prompt without a step of depth, holes filled."""
    import cv2

    rows, columns = np.nonzero(allowed)
    if not len(rows):
        raise NothingAtPrompt(f"The colours around the prompt {prompt_px} differ too much. Prompt elsewhere.")
    nearest = np.argmin((columns - prompt_px[0]) ** 2 + (rows - prompt_px[1]) ** 2)
    seed = (int(columns[nearest]), int(rows[nearest]))
    blocked = np.pad(~allowed, 1, constant_values=True).astype(np.uint8)
    flags = 4 | cv2.FLOODFILL_MASK_ONLY | (2 << 8)
    cv2.floodFill(depth_m.copy(), blocked, seed, 0, step_m, step_m, flags)
    filled = (blocked[1:-1, 1:-1] == 2).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(filled, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0)
