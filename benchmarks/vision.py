"""How long the cameras' pictures take on one core, and how good the stereo depth is, beside OpenCV's matcher.

Prints one line per figure.

Usage: python benchmarks/vision.py [--pictures N]

Looks at the fusion task's evaluated starts with undeformed gels, and at two gels after an env step; exits with 1 if the
picture of a gel takes more than 5 ms of CPU time. Needs tests/support/envs on the path, which pytest and this script
see to.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support" / "envs"))

import gymnasium
import numpy as np
import vitac.envs  # noqa: F401 - registers the environments
from visible_scenes import STARTS, SeenScene, fusion_scene
from vitac.envs.vision.look import colour_picture, depth_picture, segmentation_picture
from vitac.envs.vision.rasterizer import Label, RenderedView
from vitac.envs.vision.stereo.camera import depth_of_pair, draw_noise_keys, infrared_pair, registered_depth_m
from vitac.envs.vision.stereo.matching import LARGEST_DISPARITY, NO_DISPARITY, PARTS, SMALLEST_DISPARITY
from vitac.envs.vision.stereo.method import METHOD
from vitac.envs.vision.tactile_picture import draw_tactile_pictures

TACTILE_AIM_MS = 5.0


def colour_and_exact_depth(scene: SeenScene) -> None:
    """Render the two pictures of an observation in the mode `gt`."""
    view = scene.view()
    colour_picture(view, scene.surfaces, scene.vertices_m)
    depth_picture(view)


def colour_and_stereo_depth(scene: SeenScene) -> None:
    """Render the two pictures of an observation in the mode `stereo`."""
    view = scene.view()
    colour_picture(view, scene.surfaces, scene.vertices_m)
    stereo_depth_m(scene, view, 0)


def stereo_depth_m(scene: SeenScene, view: RenderedView, seed: int) -> np.ndarray:
    """Return the depth that the stereo camera measures [m]."""
    keys = draw_noise_keys(np.random.default_rng(seed))
    pair = infrared_pair(scene.surfaces, scene.vertices_m, pose=scene.pose, colour_view=view, noise_keys=keys)
    return depth_of_pair(pair, view)


def depth_by_opencv_m(scene: SeenScene, view: RenderedView, seed: int) -> np.ndarray:
    """Return the depth that OpenCV's semi-global block matching finds in the same infrared pair [m].

    Its settings are those of our matcher where it has the same ones (blocks of 7 x 7, penalties, uniqueness, left-right
    check, disparities); it is moved into the colour picture in the same way.
    """
    import cv2

    block = (2 * METHOD.block_radius_px + 1) ** 2
    matcher = cv2.StereoSGBM.create(
        minDisparity=METHOD.smallest_disparity_px,
        numDisparities=LARGEST_DISPARITY - SMALLEST_DISPARITY + 1,
        blockSize=2 * METHOD.block_radius_px + 1,
        P1=METHOD.small_jump * block,
        P2=METHOD.large_jump * block,
        disp12MaxDiff=METHOD.largest_left_right_difference_px,
        uniquenessRatio=METHOD.uniqueness_percent,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    keys = draw_noise_keys(np.random.default_rng(seed))
    pair = infrared_pair(scene.surfaces, scene.vertices_m, pose=scene.pose, colour_view=view, noise_keys=keys)
    sixteenths = matcher.compute(pair.left, pair.right).astype(np.int32)
    # Where it finds nothing it says one less than the smallest disparity.
    sixteenths[sixteenths < 16 * SMALLEST_DISPARITY] = NO_DISPARITY
    sixteenths[pair.left == 0] = NO_DISPARITY
    return registered_depth_m(sixteenths * (PARTS // 16), 0, 0, view.triangle)


def colour_and_opencv_depth(scene: SeenScene) -> None:
    """Render the two pictures of an observation with OpenCV's matcher in place of ours."""
    view = scene.view()
    colour_picture(view, scene.surfaces, scene.vertices_m)
    depth_by_opencv_m(scene, view, 0)


def stereo_quality(name: str, depth_of: Callable[[SeenScene, RenderedView, int], np.ndarray]) -> None:
    """Print how much of peg and base a matcher measures at all starts, and how well."""
    errors_mm: dict[Label, list[np.ndarray]] = {Label.BASE: [], Label.PEG: []}
    pixels = dict.fromkeys(errors_mm, 0)
    for seed, start in enumerate(STARTS):
        scene = fusion_scene(start)
        view = scene.view()
        depth_m = depth_of(scene, view, seed)
        shown = segmentation_picture(view, scene.surfaces)
        for label, found in errors_mm.items():
            measured = (shown == label) & (depth_m > 0)
            pixels[label] += int((shown == label).sum())
            found.append((depth_m[measured] - view.depth_m[measured]) * 1e3)
    for label, found in errors_mm.items():
        error = np.concatenate(found)
        print(
            f"{name}, {label.name.lower()}: {len(error) / pixels[label]:.1%} valid, "
            f"error {np.median(np.abs(error)):.2f} mm, "
            f"p95 {np.quantile(np.abs(error), 0.95):.2f} mm, p99 {np.quantile(np.abs(error), 0.99):.0f} mm, "
            f"median {np.median(error):+.2f} mm, mean {error.mean():+.2f} mm, {(error < -20).mean():.1%} more than "
            "20 mm too near"
        )


def cpu_ms(observe: Callable[[SeenScene], object], count: int) -> list[float]:
    """Return the CPU time of observing each of the starts in turn [ms], without the first, which compiles."""
    observe(fusion_scene(STARTS[0]))
    times = []
    for i in range(count):
        scene = fusion_scene(STARTS[i % len(STARTS)])
        before = time.process_time()
        observe(scene)
        times.append((time.process_time() - before) * 1e3)
    return times


def tactile_picture_ms(count: int) -> list[float]:
    """Return the CPU time of a picture of one gel [ms], both of them taken again and again after an env step."""
    env: Any = gymnasium.make("ViTac/FusionInsertion-v1", observation_keys=("marker_flow",)).unwrapped
    env.reset(seed=0)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    random, times = np.random.default_rng(0), []
    for _ in range(count + 1):
        before = time.process_time()
        pictures = draw_tactile_pictures(env.scene, random)
        times.append((time.process_time() - before) * 1e3 / len(pictures))
    return times[1:]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=200)
    count = parser.parse_args().pictures
    modes = [("rgb and exact depth", colour_and_exact_depth), ("rgb and stereo depth", colour_and_stereo_depth)]
    matchers = [("census and semi-global matching", stereo_depth_m)]
    if find_spec("cv2"):
        modes.append(("rgb and depth by OpenCV", colour_and_opencv_depth))
        matchers.append(("OpenCV SGBM, 3 ways", depth_by_opencv_m))
    else:
        print("OpenCV is not installed: pip install opencv-python-headless to compare with its matcher")
    for name, observe in modes:
        times = sorted(cpu_ms(observe, count))
        print(f"{name}: median {statistics.median(times):.2f} ms, p95 {times[int(0.95 * count)]:.2f} ms")
    for name, depth_of in matchers:
        stereo_quality(name, depth_of)
    times = sorted(tactile_picture_ms(count))
    print(f"tactile picture: median {statistics.median(times):.2f} ms, p95 {times[int(0.95 * count)]:.2f} ms")
    sys.exit(int(statistics.median(times) > TACTILE_AIM_MS))


if __name__ == "__main__":
    main()
