"""How long the cameras' pictures take on one core, and how good the stereo depth is; prints one line per figure.

Usage: python benchmarks/vision.py [--pictures N]

Looks at the fusion task's evaluated starts with undeformed gels. Needs tests/support/envs on the path, which pytest and
this script see to.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "support" / "envs"))

from visible_scenes import STARTS, SeenScene, fusion_scene
from vitac.envs.vision.pictures import colour_picture, depth_picture


def colour_and_exact_depth(scene: SeenScene) -> None:
    """Render the two pictures of an observation in the mode `gt`."""
    view = scene.view()
    colour_picture(view, scene.surfaces, scene.vertices_m)
    depth_picture(view)


def cpu_ms(observe: Callable[[SeenScene], object], count: int) -> list[float]:
    """CPU time of observing each of the starts in turn [ms], without the first, which compiles."""
    observe(fusion_scene(STARTS[0]))
    times = []
    for i in range(count):
        scene = fusion_scene(STARTS[i % len(STARTS)])
        before = time.process_time()
        observe(scene)
        times.append((time.process_time() - before) * 1e3)
    return times


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=200)
    count = parser.parse_args().pictures
    for name, observe in (("rgb and exact depth", colour_and_exact_depth),):
        times = sorted(cpu_ms(observe, count))
        print(f"{name}: median {statistics.median(times):.2f} ms, p95 {times[int(0.95 * count)]:.2f} ms")


if __name__ == "__main__":
    main()
