"""Acts by the best of many candidate actions, judged by a network on what both gels have felt so far.

This file is a whole submission with `weights.npz` beside it, and needs only NumPy. Training imports the same file, so
that what is learned is what is played. `vitac train export` copies it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]

GRID_U_PX = (50.0, 123.0, 197.0, 270.0)
GRID_V_PX = (45.0, 125.0, 205.0)  # symmetric about the picture's middle, so that mirrored fields are fields
REACH_PX = 32.0  # of a marker around its place
FIELD_PX = 10.0  # motions are divided by it
MOTION_SCALE = np.array([4.0, 4.0, 8.0, 1.0], dtype=np.float32)  # mm, mm, degrees, mm
MOST_STEPS = 8
CANDIDATES = 512
FIELD_SIZE = 2 * len(GRID_U_PX) * len(GRID_V_PX) * 2  # gel, place, u and v
HISTORY_SIZE = 3 * FIELD_SIZE + 2 * len(MOTION_SCALE) + MOST_STEPS


class Policy:
    """Plays peg insertion with the network in `weights.npz`."""

    def __init__(self) -> None:
        with np.load(Path(__file__).parent / "weights.npz", allow_pickle=False) as stored:
            self.weights = {name: stored[name].astype(np.float32) for name in stored.files}
        self.candidates = candidate_actions(CANDIDATES)

    def reset(self, task: str) -> None:
        """Begin an episode."""
        self.history = History()

    def act(self, observation: Mapping[str, NDArray[Any]]) -> FloatArray:
        """Return the candidate that the network thinks most of."""
        self.history.add(motion_field(observation["marker_flow"]), observation["relative_motion"])
        best = int(np.argmax(values(self.weights, self.history.features(), self.candidates)))
        return np.asarray(self.candidates[best])


class History:
    """What the network is told of an episode: fields now, before and at the first touch, motions now and before."""

    def __init__(self) -> None:
        self.fields: list[FloatArray] = []
        self.motions: list[FloatArray] = []

    def add(self, field: FloatArray, motion: NDArray[Any]) -> None:
        """Add an observation."""
        self.fields.append(field)
        self.motions.append(np.asarray(motion, dtype=np.float32) / MOTION_SCALE)

    def features(self) -> FloatArray:
        """Return what the network is told, shape [HISTORY_SIZE]."""
        return history_features(np.array(self.fields), np.array(self.motions), len(self.fields) - 1)


def history_features(fields: FloatArray, motions: FloatArray, step: int) -> FloatArray:
    """Return what the network is told after so many env steps.

    Args:
        fields: of the observations of an episode, shape [n, FIELD_SIZE].
        motions: divided by their scale, shape [n, 4].
        step: env steps played so far, less than n.
    """
    before = max(step - 1, 0)
    count = np.zeros(MOST_STEPS, dtype=np.float32)
    count[min(step, MOST_STEPS - 1)] = 1.0
    parts = [fields[step], fields[before], fields[0], motions[step], motions[before], count]
    return np.asarray(np.concatenate(parts), dtype=np.float32)


def motion_field(marker_flow: NDArray[Any]) -> FloatArray:
    """Return the motion of both gels' markers at the places of a grid, shape [FIELD_SIZE].

    Every observation has markers of its own, so what is compared is the field that they sample: at each place the mean
    motion of the markers around it, the nearer the more. The last marker is repeated to fill the array; it counts once.
    """
    places = np.array([(u, v) for v in GRID_V_PX for u in GRID_U_PX])
    fields = []
    for reference, current in np.asarray(marker_flow, dtype=np.float64):
        count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
        away = reference[:count, None, :] - places[None, :, :]
        nearness = np.exp(-0.5 * (away**2).sum(axis=2) / REACH_PX**2) + 1e-9
        motion = (current - reference)[:count]
        fields.append((nearness[:, :, None] * motion[:, None, :]).sum(axis=0) / nearness.sum(axis=0)[:, None])
    return np.asarray((np.array(fields) / FIELD_PX).ravel(), dtype=np.float32)


def candidate_actions(count: int) -> FloatArray:
    """Return actions that fill the cube of all actions evenly, and its middle first, shape [count, 3].

    An additive recurrence on the plastic number's generalisation to three dimensions (Roberts 2018).
    """
    root = 1.2207440846057596
    steps = np.array([1.0 / root, 1.0 / root**2, 1.0 / root**3])
    numbers = np.arange(count)[:, None] * steps
    return np.asarray(2.0 * ((0.5 + numbers) % 1.0) - 1.0, dtype=np.float32)


def values(weights: Mapping[str, FloatArray], history: FloatArray, actions: FloatArray) -> FloatArray:
    """Return what the network thinks of actions after a history: the mean of its copies, shape [count].

    Args:
        weights: arrays by name: for each copy the layers' weights and biases.
        history: shape [HISTORY_SIZE].
        actions: shape [count, 3].
    """
    copies = sum(name.endswith("_history") for name in weights)
    total = np.zeros(len(actions), dtype=np.float32)
    for copy in range(copies):
        layer = {name.removeprefix(f"{copy}_"): value for name, value in weights.items() if name.startswith(f"{copy}_")}
        hidden = np.maximum(history @ layer["history"] + actions @ layer["action"] + layer["bias0"], 0.0)
        hidden = np.maximum(hidden @ layer["weight1"] + layer["bias1"], 0.0)
        total += (hidden @ layer["weight2"] + layer["bias2"])[:, 0]
    return np.asarray(total / copies)
