"""Where a LeRobotDataset has its files, and what its columns are; versions 2.1 and 3.0.

The format is described in the documentation of LeRobot, under "LeRobotDataset v3.0".
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import chain
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vitac.envs.observable import Observable
from vitac.evaluator.tracks import Task

from ..frames import is_coloured_picture

INFO = Path("meta/info.json")
STATS = Path("meta/stats.json")
FILES_OF_A_CHUNK = 1000
STATE_HASH = "state_hash"


class Version(StrEnum):
    """A version of the format."""

    V2_1 = "v2.1"
    """One file for every episode."""
    V3_0 = "v3.0"
    """Many episodes in a file."""

    @property
    def episodes_of_a_file(self) -> int:
        """How many episodes are in a file that we write."""
        return 1 if self is Version.V2_1 else 50

    @property
    def data_path(self) -> str:
        """Name of a file with a table."""
        if self is Version.V2_1:
            return "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        return "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

    @property
    def video_path(self) -> str:
        """Name of a file with a video."""
        if self is Version.V2_1:
            return "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
        return "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"


def format_path(template: str, number: int, video_key: str = "", chunk_size: int = FILES_OF_A_CHUNK) -> str:
    """Return the name of the file with this number, counted over all chunks from 0."""
    chunk, within = divmod(number, chunk_size)
    return template.format(
        chunk_index=chunk, file_index=within, episode_chunk=chunk, episode_index=number, video_key=video_key
    )


@dataclass(frozen=True, kw_only=True)
class Feature:
    """A column of the table, or a video.

    Attributes:
        name: of the column.
        dtype: of its numbers; "string" or "video" where it has none.
        shape: of an entry; (1,) for a single number.
        names: of the numbers of an entry, or of the axes of a picture.
        keys: of the observations that it holds, if any.
        read: makes its entries of those of the observations; None: they are those of the only one.
    """

    name: str
    dtype: str
    shape: tuple[int, ...]
    names: Sequence[str] | None = None
    keys: tuple[str, ...] = ()
    read: Callable[..., NDArray[Any]] | None = None

    def describe(self, fps: float) -> dict[str, Any]:
        """Return the entry of `info.json`."""
        described = {"dtype": self.dtype, "shape": list(self.shape), "names": self.names and list(self.names)}
        if self.dtype != "video":
            return described
        height_px, width_px, channels = self.shape
        video: dict[str, Any] = {"fps": fps, "height": height_px, "width": width_px, "channels": channels}
        video |= {"codec": "mpeg4", "pix_fmt": "yuv420p", "is_depth_map": False}
        return {**described, "info": {**{f"video.{name}": value for name, value in video.items()}, "has_audio": False}}


INDICES = (
    Feature(name="timestamp", dtype="float32", shape=(1,)),
    Feature(name="frame_index", dtype="int64", shape=(1,)),
    Feature(name="episode_index", dtype="int64", shape=(1,)),
    Feature(name="index", dtype="int64", shape=(1,)),
    Feature(name="task_index", dtype="int64", shape=(1,)),
)
"""Columns that every data set has."""


def list_features(
    task: Task, observables: Sequence[Observable[Any]], *, only_vectors: bool = False
) -> tuple[Feature, ...]:
    """Return all columns of a task: what is seen, done, found, and the indices.

    Args:
        task: of the demonstrations.
        observables: what is seen.
        only_vectors: of what is seen, vectors and pictures alone, which is what LeRobot's own policies read. Reading a
            frame with the markers takes LeRobot 3.5 times as long.
    """
    actions = [component.name for component in task.actions]
    state = [entry for entry in observables if not entry.privileged and len(entry.shape) <= 1]
    observed = chain(_state(state), *(_observed(entry) for entry in observables if entry not in state))
    return (
        *(feature for feature in observed if not only_vectors or feature.dtype == "video" or len(feature.shape) == 1),
        Feature(name="action", dtype="float32", shape=(len(actions),), names=actions),
        Feature(name="next.reward", dtype="float32", shape=(1,)),
        Feature(name="next.done", dtype="bool", shape=(1,)),
        Feature(name="next.success", dtype="bool", shape=(1,)),
        Feature(name=STATE_HASH, dtype="string", shape=(1,)),
        *INDICES,
    )


def _state(entries: Sequence[Observable[Any]]) -> Iterator[Feature]:
    """Yield the column of all that a policy sees in single numbers and vectors, touch aside.

    LeRobot's own policies read no other vector beside that of touch, and none of one number.
    """
    names = [
        entry.name if prod(entry.shape) == 1 else f"{entry.name}_{number}"
        for entry in entries
        for number in range(prod(entry.shape))
    ]
    if entries:
        keys = tuple(entry.name for entry in entries)
        yield Feature(
            name="observation.state", dtype="float32", shape=(len(names),), names=names, keys=keys, read=_join
        )


def _join(*columns: NDArray[Any]) -> NDArray[np.float32]:
    return np.column_stack(columns).astype(np.float32)


def _observed(entry: Observable[Any]) -> Iterator[Feature]:
    """Yield the columns of an observable: as it is, and what LeRobot's own policies can read of touch."""
    axes = ("height", "width", "channels")
    if entry.name == TACTILE_PICTURES:
        for gel, side in enumerate(SIDES):
            name = f"observation.images.{side}"
            yield Feature(
                name=name,
                dtype="video",
                shape=entry.shape[1:],
                names=axes,
                keys=(entry.name,),
                read=partial(_picture, gel),
            )
    elif is_coloured_picture(entry):
        yield Feature(
            name=f"observation.images.{entry.name}", dtype="video", shape=entry.shape, names=axes, keys=(entry.name,)
        )
    elif entry.privileged:
        yield Feature(name=f"privileged.{entry.name}", dtype=entry.dtype, shape=entry.shape, keys=(entry.name,))
    else:
        yield Feature(name=f"observation.{entry.name}", dtype=entry.dtype, shape=entry.shape, keys=(entry.name,))
    if entry.name == MARKERS:
        yield Feature(
            name="observation.environment_state",
            dtype="float32",
            shape=(len(MOTION_NAMES),),
            names=MOTION_NAMES,
            keys=(entry.name,),
            read=fit_motions,
        )


MARKERS, TACTILE_PICTURES, SIDES = "marker_flow", "rgb_images", ("left", "right")
MOTION_NAMES = tuple(
    f"{side}_{axis}_{term}" for side in SIDES for term in ("mean", "along_u", "along_v") for axis in ("u", "v")
)
_CENTRE_PX, _SPREAD_PX = np.array([160.0, 125.0]), 100.0
"""Middle of the markers in a sensor's picture, and the distance at which a slope's number is its motion."""


def _picture(gel: int, pictures: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the pictures of one gel in red, green and blue, shape [n, h, w, 3]."""
    return pictures[:, gel, ..., ::-1]


def fit_motions(flows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fit the motion of each gel's markers by a mean and slopes over the picture, by least squares [px].

    Every observation may have another grid of markers, so that a network cannot compare them one by one.

    Args:
        flows: reference and current markers of both gels, shape [n, 2, 2, markers, 2]; the last is repeated.

    Returns:
        Numbers in the order of `MOTION_NAMES`, shape [n, 12].
    """
    rows = []
    for gels in flows.astype(np.float64):
        fitted = []
        for reference, current in gels:
            count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))
            place = (reference[:count] - _CENTRE_PX) / _SPREAD_PX
            columns = np.column_stack([np.ones(count), place])
            fitted.append(np.linalg.lstsq(columns, (current - reference)[:count], rcond=None)[0].ravel())
        rows.append(np.concatenate(fitted))
    return np.array(rows, dtype=np.float32)


def make_info(
    version: Version, features: Sequence[Feature], *, fps: float, episodes: int, frames: int, files: int
) -> Mapping[str, Any]:
    """Return the content of `info.json`."""
    videos = sum(feature.dtype == "video" for feature in features)
    chunks = -(-files // FILES_OF_A_CHUNK)
    own = {"total_videos": videos * episodes, "total_chunks": chunks} if version is Version.V2_1 else {}
    sizes = {} if version is Version.V2_1 else {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
    return {
        "codebase_version": version.value,
        "robot_type": "vitac-arena",
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        **own,
        "chunks_size": FILES_OF_A_CHUNK,
        **sizes,
        "fps": fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": version.data_path,
        "video_path": version.video_path if videos else None,
        "features": {feature.name: feature.describe(fps) for feature in features},
    }


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
    summary = {"min": values.min(axis=0), "max": values.max(axis=0)}
    summary |= {"mean": values.mean(axis=0), "std": values.std(axis=0)}
    quantiles = np.quantile(values, list(_QUANTILES.values()), axis=0)
    return summary | dict(zip(_QUANTILES, quantiles, strict=True))


class Total:
    """Statistics of all episodes so far; their quantiles are the mean of the episodes' own, as LeRobot's are."""

    def __init__(self) -> None:
        self._count: dict[str, int] = {}
        self._sums: dict[str, dict[str, NDArray[Any]]] = {}
        self._limits: dict[str, dict[str, NDArray[Any]]] = {}

    def add(self, episode: Statistics) -> None:
        """Take an episode into account."""
        for name, summary in episode.items():
            count = int(summary["count"][0])
            parts = {quantile: summary[quantile] for quantile in _QUANTILES} | {"mean": summary["mean"]}
            parts["square"] = summary["std"] ** 2 + summary["mean"] ** 2
            if name not in self._sums:
                self._count[name] = 0
                self._sums[name] = {part: np.zeros_like(value) for part, value in parts.items()}
                self._limits[name] = {"min": summary["min"], "max": summary["max"]}
            self._count[name] += count
            for part, value in parts.items():
                self._sums[name][part] = self._sums[name][part] + count * value
            limits = self._limits[name]
            limits["min"] = np.minimum(limits["min"], summary["min"])
            limits["max"] = np.maximum(limits["max"], summary["max"])

    def result(self) -> Statistics:
        """Return the statistics of all."""
        summaries = {}
        for name, sums in self._sums.items():
            means = {part: value / self._count[name] for part, value in sums.items()}
            square = means.pop("square")
            std = np.sqrt(np.maximum(square - means["mean"] ** 2, 0.0))
            summaries[name] = {**self._limits[name], **means, "std": std, "count": np.array([self._count[name]])}
        return summaries


def as_lists(statistics: Statistics) -> dict[str, dict[str, Any]]:
    """Return the same as JSON values."""
    return {name: {key: value.tolist() for key, value in summary.items()} for name, summary in statistics.items()}
