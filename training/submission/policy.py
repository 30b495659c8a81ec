"""Acts by the best of many candidate actions, assessed by a network on what both gels have felt so far.

This file is a whole submission with `weights.npz` beside it, and needs only NumPy. Training imports the same file, so
that what is learned is what is played. `vitac train export` copies it.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]

FOCAL_PX = np.array([340.0, 325.0])  # of a sensor's camera, along u and v
CENTRE_PX = np.array([160.0, 125.0])
EYE_MM = 21.125  # from the camera to the side of the gripped peg
HALF_WIDTH_MM = 15.0  # of the gripped peg
FELT_SIZE = 6
FELT_SCALE = np.array([0.05, 0.05, 0.05, 0.1, 0.1, 0.1], dtype=np.float32)  # mm, degrees; below it all is noise
MOTION_SCALE_MM, ANGLE_SCALE_DEG = 4.0, 8.0
ACTION_MM = 2.0  # motion of an action of 1 along x and y
MAX_STEPS = 8
MOMENT_SIZE = FELT_SIZE + 4  # what was felt, where the gripper is: x, y, theta, and whether theta is known
CANDIDATES = 512
HISTORY_SIZE = (MAX_STEPS + 1) * MOMENT_SIZE + MAX_STEPS


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
        self.history.observed(felt_motion(observation["marker_flow"]), observation["relative_motion"])
        best = int(np.argmax(values(self.weights, self.history.features(), self.candidates)))
        self.history.acted(self.candidates[best])
        return np.asarray(self.candidates[best])

    def belief(self) -> FloatArray | None:
        """Return the peg's offset [mm, mm, deg] as far as it knows it, for `vitac show`; no action depends on it."""
        if "belief" not in self.weights:
            return None
        return np.asarray(belief_inputs(self.weights, self.history.features()[None])[0] @ self.weights["belief"])


class History:
    """All that was felt and done in an episode so far."""

    def __init__(self) -> None:
        self.felt: list[FloatArray] = []
        self.motions: list[NDArray[Any]] = []
        self.actions: list[FloatArray] = []

    def observed(self, felt: FloatArray, motion: NDArray[Any]) -> None:
        """Add what was felt and how far the gripper has moved [mm, mm, deg, mm]."""
        self.felt.append(felt)
        self.motions.append(np.asarray(motion, dtype=np.float32))

    def acted(self, action: FloatArray) -> None:
        """Add what was done then."""
        self.actions.append(action)

    def features(self) -> FloatArray:
        """Return what the network gets, shape [HISTORY_SIZE]."""
        features = history_features(np.array(self.felt), np.array(self.motions), np.array(self.actions).reshape(-1, 3))
        return np.asarray(features[-1])


def history_features(felt: FloatArray, motions: FloatArray, actions: FloatArray) -> FloatArray:
    """Return what the network gets at every moment of an episode, shape [n, HISTORY_SIZE].

    Args:
        felt: of the observations, shape [n, FELT_SIZE] [mm, deg].
        motions: of the gripper since the reset [mm, mm, deg, mm], shape [n, 4].
        actions: between them, shape [n - 1, 3] or more.
    """
    count = len(felt)
    start_deg, known = start_angles_deg(motions, actions[: count - 1])
    moments = np.column_stack(
        [
            0.5 * np.arcsinh(felt / FELT_SCALE),
            motions[:, :2] / MOTION_SCALE_MM,
            (start_deg + motions[:, 2]) / ANGLE_SCALE_DEG,
            known,
        ]
    )
    features = np.zeros((count, HISTORY_SIZE), dtype=np.float32)
    for number in range(min(count, MAX_STEPS)):
        features[number, :MOMENT_SIZE] = moments[number]
        features[number, MOMENT_SIZE : (number + 2) * MOMENT_SIZE] = moments[: number + 1].ravel()
        features[number, (MAX_STEPS + 1) * MOMENT_SIZE + number] = 1.0
    return features


def start_angles_deg(motions: FloatArray, actions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return theta at the reset as far as it is known at every moment [deg], or 0, and whether it is, shapes [n].

    An action moves the gripper along its own axes, but `relative_motion` has it along those of the hole: the angle
    between both is the gripper's. The first motion that is long enough tells it; before, nothing does.
    """
    angles, known = np.zeros(len(motions)), np.zeros(len(motions))
    for number, action in enumerate(np.asarray(actions, dtype=np.float64)):
        if known[number] or np.hypot(*action[:2]) < 0.02:
            angles[number + 1], known[number + 1] = angles[number], known[number]
            continue
        moved = motions[number + 1, :2] - motions[number, :2]
        turned = np.degrees(np.arctan2(moved[1], moved[0]) - np.arctan2(action[1], action[0]))
        angles[number + 1] = (turned + 180.0) % 360.0 - 180.0 - motions[number, 2]
        known[number + 1] = 1.0
    return angles.astype(np.float32), known.astype(np.float32)


def felt_motion(marker_flow: NDArray[Any]) -> FloatArray:
    """Return how the peg has moved in the grip since the grasp, shape [FELT_SIZE].

    The gels stick to the peg, so that their markers move as its sides do: as a rigid body. Its small motion, along the
    gripper's axes x, y, z [mm] and about them [deg], is fitted to all markers of both gels by least squares.
    """
    rows, moved = [], []
    for side, (reference, current) in zip((1.0, -1.0), np.asarray(marker_flow, dtype=np.float64), strict=True):
        count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))  # the last marker is repeated to fill
        before, now = (reference[:count] - CENTRE_PX) / FOCAL_PX, (current[:count] - CENTRE_PX) / FOCAL_PX
        x, y, z = -side * EYE_MM * before[:, 1], side * HALF_WIDTH_MM + 0.0 * before[:, 0], EYE_MM * before[:, 0]
        none, one = np.zeros(count), np.ones(count)
        along_x = np.column_stack([one, none, none, none, z, -y])
        along_y = np.column_stack([none, one, none, -z, none, x])
        along_z = np.column_stack([none, none, one, y, -x, none])
        rows += [along_z + side * now[:, :1] * along_y, -side * along_x + side * now[:, 1:] * along_y]
        moved += [EYE_MM * (now - before)[:, 0], EYE_MM * (now - before)[:, 1]]
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(moved), rcond=None)[0]
    return np.concatenate([found[:3], np.degrees(found[3:])]).astype(np.float32)


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
    copies = count_copies(weights)
    total = np.zeros(len(actions), dtype=np.float32)
    for copy in range(copies):
        layer = {name.removeprefix(f"{copy}_"): value for name, value in weights.items() if name.startswith(f"{copy}_")}
        hidden = np.maximum(history @ layer["history"] + actions @ layer["action"] + layer["bias0"], 0.0)
        hidden = np.maximum(hidden @ layer["weight1"] + layer["bias1"], 0.0)
        total += (hidden @ layer["weight2"] + layer["bias2"])[:, 0]
    return np.asarray(total / copies)


def belief_inputs(weights: Mapping[str, FloatArray], histories: FloatArray) -> FloatArray:
    """Return what the belief is a weighted sum of: histories, the networks' first layers without an action, and 1.

    Args:
        weights: as for `values`.
        histories: shape [n, HISTORY_SIZE].
    """
    layers = [
        np.maximum(histories @ weights[f"{copy}_history"] + weights[f"{copy}_bias0"], 0.0)
        for copy in range(count_copies(weights))
    ]
    return np.concatenate([histories, *layers, np.ones((len(histories), 1), dtype=np.float32)], axis=1)


def count_copies(weights: Mapping[str, FloatArray]) -> int:
    """Return how many networks there are."""
    return sum(name.endswith("_history") for name in weights)
