"""Action chunking with a transformer, cloned from demonstrations: what was felt so far gives the next four actions.

As ACT (Zhao et al., 2023, arXiv:2304.13705) without its variational part: an encoder reads the last env steps, a
decoder has one query for each action to come, and the actions that were foreseen for now are averaged. `train.py`
learns the same network in torch. Needs only NumPy.
"""

from pathlib import Path

import numpy as np

WINDOW = 8  # env steps that are looked back
CHUNK = 4  # actions that are foreseen
HEADS = 4
LAYERS = 2
FADING = 0.3  # a forecast that is one env step older counts exp(-FADING) as much
IMAGE_CENTRE = np.array([160.0, 125.0])  # pixels


class Policy:
    """Remembers what was felt and what was foreseen in the episode."""

    def __init__(self):
        with np.load(Path(__file__).parent / "weights.npz", allow_pickle=False) as stored:
            self.weights = {name: stored[name].astype(np.float64) for name in stored.files}

    def reset(self, task):
        """Begin an episode."""
        self.seen = []
        self.foreseen = []

    def act(self, observation):
        """Return the mean of what was foreseen for now."""
        self.seen.append(features(observation["marker_flow"], observation["relative_motion"]))
        tokens = (np.array(self.seen[-WINDOW:]) - self.weights["mean"]) / self.weights["scale"]
        self.foreseen.append(chunk(self.weights, tokens))
        recent = self.foreseen[-CHUNK:][::-1]
        ages = np.arange(len(recent))
        share = np.exp(-FADING * ages) / np.exp(-FADING * ages).sum()
        action = sum(part * actions[age] for part, age, actions in zip(share, ages, recent, strict=True))
        # Rounded, so that differences in the last bits of another machine do not change the episode.
        return np.clip(np.round(action, 3), -1, 1).astype(np.float32)


def features(marker_flow, relative_motion):
    """Return the affine motions of the markers in both gels [pixels] and the gripper's motion [mm], shape [15]."""
    parts = [affine_motion(reference, current) for reference, current in marker_flow]
    return np.concatenate([*parts, np.asarray(relative_motion, dtype=np.float64)])


def affine_motion(reference, current):
    """Fit the markers' motion by a constant and slopes over the image; return six numbers [pixel].

    The last marker is repeated to fill the array; only its first copy counts.
    """
    count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
    motion = (current - reference)[:count].astype(np.float64)
    place = (reference[:count].astype(np.float64) - IMAGE_CENTRE) / 100
    columns = np.concatenate([np.ones((count, 1)), place], axis=1)
    return np.linalg.lstsq(columns, motion, rcond=None)[0].ravel()


def chunk(weights, tokens):
    """Return the next actions, shape [CHUNK, a], from what was felt, shape [n, f], the newest last."""
    state = linear(weights, "embed", tokens) + weights["age"][: len(tokens)][::-1]
    for layer in range(LAYERS):
        near = norm(weights, f"encoder.{layer}.norm", state)
        state = state + attention(weights, f"encoder.{layer}", near, near)
        state = state + feed(weights, f"encoder.{layer}", state)
    queries = weights["query"]
    queries = queries + attention(weights, "decoder", norm(weights, "decoder.norm", queries), state)
    queries = queries + feed(weights, "decoder", queries)
    return linear(weights, "action", norm(weights, "last", queries))


def linear(weights, name, values):
    """Return values after a linear layer."""
    return values @ weights[f"{name}.weight"].T + weights[f"{name}.bias"]


def norm(weights, name, values):
    """Return values with mean 0 and variance 1, scaled and moved."""
    centred = values - values.mean(axis=-1, keepdims=True)
    normal = centred / np.sqrt((centred**2).mean(axis=-1, keepdims=True) + 1e-5)
    return normal * weights[f"{name}.weight"] + weights[f"{name}.bias"]


def feed(weights, name, values):
    """Return what the two layers after an attention add."""
    hidden = linear(weights, f"{name}.up", norm(weights, f"{name}.norm2", values))
    return linear(weights, f"{name}.down", np.maximum(hidden, 0.0))


def attention(weights, name, asking, asked):
    """Return what the rows of one array find in those of another."""
    query, key, value = (
        linear(weights, f"{name}.{part}", rows).reshape(len(rows), HEADS, -1).swapaxes(0, 1)
        for part, rows in (("q", asking), ("k", asked), ("v", asked))
    )
    scores = query @ key.swapaxes(1, 2) / np.sqrt(query.shape[-1])
    shares = np.exp(scores - scores.max(axis=-1, keepdims=True))
    found = (shares / shares.sum(axis=-1, keepdims=True)) @ value
    return linear(weights, f"{name}.out", found.swapaxes(0, 1).reshape(len(asking), -1))
