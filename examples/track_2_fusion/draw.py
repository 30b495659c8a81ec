"""Draws what the policy sees at a random start with each peg: `python examples/track_2_fusion/draw.py FILE.png [SEED]`.

Dots are the borders between colours, lines the outlines that fit them. Needs matplotlib (extra `show`).
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv

sys.path.insert(0, str(Path(__file__).resolve().parent / "Track_2"))

from outline_fit import edge_ends, outline_edges
from picture import Picture
from policy import Policy
from solids import place_base, place_peg

KEYS = ("relative_motion", "rgb_picture", "depth_picture", "marker_flow")
RIM_OFFSET = 9.5  # mm: offset z at which the peg's lower end is as high as the rim


def draw(file: Path, seed: int) -> None:
    """Write the picture of two starts side by side."""
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    for axes, left in zip(figure.subplots(1, 2), (1, 0), strict=True):
        x, y, theta = np.random.default_rng([seed, left]).uniform([-5, -5, -10], [5, 5, 10])
        draw_start(axes, (x, y, theta, 6.0, left))
    figure.savefig(file, dpi=100)


def draw_start(axes, start):
    """Draw the first look at a start, and say how well it is seen."""
    env = FusionInsertionEnv(observation_keys=KEYS)
    observation, info = env.reset(options={"start": start, "rng_seed": (0, 0)})
    policy = Policy()
    policy.reset("fusion-insertion")
    policy.act(observation)
    picture = Picture(observation["rgb_picture"], observation["depth_picture"])
    x, y, theta, z = policy.starts[0]
    axes.imshow(observation["rgb_picture"], extent=(0, 640, 480, 0))
    for borders, solids, colour in (
        (picture.base_outline(), place_base(y, z), "orange"),
        (picture.peg_outline(), place_peg(policy.shape, x, theta), "lime"),
    ):
        axes.plot(*borders.T, ".", color=colour, markersize=3)
        axes.plot(*edge_ends(solids, outline_edges(solids)).T, color="black", linewidth=0.8)
    rows, columns = np.nonzero((observation["rgb_picture"] < 255).any(axis=2))
    axes.set(xlim=(columns.min() - 5, columns.max() + 5), ylim=(rows.max() + 5, rows.min() - 5), xticks=[], yticks=[])
    place = info["gt_offset_mm_deg"] + [0.0, env.task_scene.target.y_mm, 0.0, -RIM_OFFSET]
    seen, true = (
        "x {:.2f} mm, y {:.2f} mm, theta {:.2f}°, z {:.2f} mm".format(*given) for given in (policy.starts[0], place)
    )
    axes.set_title(f"{policy.shape}\nseen: {seen}\ntrue: {true}", fontsize=9)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
