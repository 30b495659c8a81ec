"""Acts as an expert would, by a network that learned the expert's actions from what a policy observes.

This file is a whole submission with `weights.npz` beside it, and needs only NumPy. Training imports the same file, so
that what is learned is what is played. It reads what its submission lists: `marker_flow`, `rgb_picture`, and whatever
has few numbers as it is.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]

MARKERS, PICTURE = "marker_flow", "rgb_picture"
WINDOW = 8  # env steps that are remembered
LAYERS = 3
IMAGE_CENTRE = np.array([160.0, 125.0])  # of a sensor's camera [pixel]
NOISE_PX = 0.3  # motion of markers below which there is mostly noise
SEEN = (slice(170, 360), slice(225, 465))  # where peg and base are in the picture, wherever the gripper is
SEEN_SCALE_PX = 40.0


class Policy:
    """Plays with the network in `weights.npz`."""

    def __init__(self) -> None:
        with np.load(Path(__file__).parent / "weights.npz", allow_pickle=False) as stored:
            self.weights = {name: stored[name].astype(np.float32) for name in stored.files}

    def reset(self, task: str) -> None:
        """Begin an episode."""
        self.memory = Memory(self.weights[f"bias{LAYERS - 1}"].size)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> FloatArray:
        """Return what the expert would do."""
        self.memory.observe(observation)
        action = choose_action(self.weights, np.array(self.memory.rows))
        self.memory.last_action = action
        return action


class Memory:
    """What was observed and done in an episode.

    Attributes:
        rows: one for each observation, with the action before it at the end.
        last_action: zeros before the first.
    """

    def __init__(self, actions: int) -> None:
        self.rows: list[FloatArray] = []
        self.last_action = np.zeros(actions, dtype=np.float32)

    def observe(self, observation: Mapping[str, NDArray[Any]]) -> None:
        """Add an observation."""
        self.rows.append(np.concatenate([read_observation(observation), self.last_action]).astype(np.float32))


def choose_action(weights: Mapping[str, FloatArray], rows: FloatArray) -> FloatArray:
    """Return the action after some rows.

    It is rounded, so that differences in the last bits of another machine do not change the episode.
    """
    windows = make_windows((rows - weights["mean"]) / weights["scale"])
    return np.asarray(np.clip(np.round(compute_layers(weights, windows[-1:])[-1][0], 3), -1.0, 1.0), dtype=np.float32)


def compute_layers(weights: Mapping[str, FloatArray], inputs: FloatArray) -> list[FloatArray]:
    """Return the inputs and what each layer makes of them; the last one gives the actions."""
    layers = [inputs]
    for number in range(LAYERS):
        values = layers[-1] @ weights[f"weight{number}"] + weights[f"bias{number}"]
        layers.append(np.maximum(values, 0.0) if number < LAYERS - 1 else values)
    return layers


def make_windows(rows: FloatArray) -> FloatArray:
    """Return what the network gets after each row of an episode: the last rows, the newest first, and how many."""
    count, size = rows.shape
    windows = np.zeros((count, WINDOW * (size + 1)), dtype=np.float32)
    for age in range(min(WINDOW, count)):
        windows[age:, age * size : (age + 1) * size] = rows[: count - age]
        windows[age:, WINDOW * size + age] = 1.0
    return windows


def read_observation(observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Return the numbers that the network gets of an observation."""
    parts = [np.ravel(observation[key]) for key in sorted(observation) if key not in (MARKERS, PICTURE)]
    if MARKERS in observation:
        felt = [fit_motion(*flow) for flow in observation[MARKERS]]
        parts += [np.arcsinh(each / NOISE_PX) for each in felt]
    if PICTURE in observation:
        red, green, blue = np.moveaxis(observation[PICTURE][SEEN], 2, 0)
        parts += [compute_moments((red > 200) & (green < 100)), compute_moments((blue > 200) & (green < 100))]
    return np.concatenate(parts, dtype=np.float64)


def fit_motion(reference: NDArray[Any], current: NDArray[Any]) -> NDArray[np.float64]:
    """Fit the markers' motion in a gel by a constant and slopes over the image, and return six numbers [pixel].

    The last marker is repeated to fill the array; only its first copy counts.
    """
    count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
    motion = (current - reference)[:count].astype(np.float64)
    place = (reference[:count].astype(np.float64) - IMAGE_CENTRE) / 100
    columns = np.concatenate([np.ones((count, 1)), place], axis=1)
    return np.asarray(np.linalg.lstsq(columns, motion, rcond=None)[0].ravel())


def compute_moments(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return area, middle, and central moments up to the third order of what a mask shows, all of order 1."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return np.zeros(10)
    v, u = rows / SEEN_SCALE_PX, columns / SEEN_SCALE_PX
    middle_u, middle_v = u.mean(), v.mean()
    u, v = u - middle_u, v - middle_v
    uu, uv, vv = u * u, u * v, v * v
    moments = [each.mean() for each in (uu, uv, vv, uu * u, uu * v, vv * u, vv * v)]
    return np.array([len(rows) / SEEN_SCALE_PX**2, middle_u, middle_v, *moments])
