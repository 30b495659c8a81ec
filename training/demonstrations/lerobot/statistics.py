"""Statistics of the columns, of each episode and of all, as LeRobot normalizes by them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .layout import Feature

Statistics = dict[str, dict[str, NDArray[Any]]]

_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_PICTURE_STRIDE = 8
"""Pixels from one that counts to the next."""


def describe_episode(columns: dict[str, Any], features: Sequence[Feature]) -> Statistics:
    """Return the statistics of an episode: of pictures by colour in 0 to 1, of text none."""
    return {
        feature.name: _describe(np.asarray(columns[feature.name]), feature)
        for feature in features
        if feature.dtype != "string"
    }


def _describe(values: NDArray[Any], feature: Feature) -> dict[str, NDArray[Any]]:
    count = np.array([len(values)])
    if feature.dtype == "video":
        dots = values[:, ::_PICTURE_STRIDE, ::_PICTURE_STRIDE].reshape(-1, 3) / 255.0
        return {**{name: each.reshape(3, 1, 1) for name, each in _summarize(dots).items()}, "count": count}
    return {**_summarize(values.reshape(len(values), *feature.shape).astype(np.float64)), "count": count}


def _summarize(values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    found = {"min": values.min(axis=0), "max": values.max(axis=0)}
    found |= {"mean": values.mean(axis=0), "std": values.std(axis=0)}
    quantiles = np.quantile(values, list(_QUANTILES.values()), axis=0)
    return found | dict(zip(_QUANTILES, quantiles, strict=True))


class Total:
    """Statistics of all episodes so far; their quantiles are the mean of the episodes' own, as LeRobot's are."""

    def __init__(self) -> None:
        self._count: dict[str, int] = {}
        self._sums: dict[str, dict[str, NDArray[Any]]] = {}
        self._limits: dict[str, dict[str, NDArray[Any]]] = {}

    def add(self, episode: Statistics) -> None:
        """Take an episode into account."""
        for name, found in episode.items():
            count = int(found["count"][0])
            parts = {quantile: found[quantile] for quantile in _QUANTILES} | {"mean": found["mean"]}
            parts["square"] = found["std"] ** 2 + found["mean"] ** 2
            if name not in self._sums:
                self._count[name] = 0
                self._sums[name] = {part: np.zeros_like(value) for part, value in parts.items()}
                self._limits[name] = {"min": found["min"], "max": found["max"]}
            self._count[name] += count
            for part, value in parts.items():
                self._sums[name][part] = self._sums[name][part] + count * value
            limits = self._limits[name]
            limits["min"] = np.minimum(limits["min"], found["min"])
            limits["max"] = np.maximum(limits["max"], found["max"])

    def result(self) -> Statistics:
        """Return the statistics of all."""
        found = {}
        for name, sums in self._sums.items():
            means = {part: value / self._count[name] for part, value in sums.items()}
            square = means.pop("square")
            std = np.sqrt(np.maximum(square - means["mean"] ** 2, 0.0))
            found[name] = {**self._limits[name], **means, "std": std, "count": np.array([self._count[name]])}
        return found


def as_lists(statistics: Statistics) -> dict[str, dict[str, Any]]:
    """Return the same as JSON values."""
    return {name: {key: value.tolist() for key, value in found.items()} for name, found in statistics.items()}
