"""Writes demonstrations as a LeRobotDataset, one file after the other, so that only one is in memory."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ...files import write_text
from ..collecting import Source
from ..frames import Frames
from .layout import (
    FILES_OF_A_CHUNK,
    INFO,
    STATE_HASH,
    STATS,
    Feature,
    Total,
    Version,
    as_lists,
    describe_episode,
    format_path,
    make_info,
)

if TYPE_CHECKING:
    import pyarrow as pa


def make_column(values: Any, feature: Feature) -> "pa.Array":
    """Return the entries of a column: numbers, lists of a fixed length, or lists of lists where it has more axes."""
    import pyarrow as pa

    if feature.dtype == "string":
        return pa.array(values, pa.string())
    array = np.asarray(values, dtype=feature.dtype)
    column = pa.array(array.reshape(-1))
    if feature.shape == (1,):
        return column
    if len(feature.shape) == 1:
        return pa.FixedSizeListArray.from_arrays(column, feature.shape[0])
    for length in reversed(feature.shape):
        offsets = np.arange(0, len(column) + 1, length, dtype=np.int32)
        column = pa.ListArray.from_arrays(offsets, column)
    return column


def write_table(path: Path, parts: Sequence[Mapping[str, Any]]) -> None:
    """Write a table of parts with the same columns, or of rows."""
    import pyarrow as pa
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(next(iter(parts[0].values())), pa.Array):
        table = pa.concat_tables(pa.table(dict(part)) for part in parts)
    else:
        table = pa.Table.from_pylist([dict(part) for part in parts])
    parquet.write_table(table.combine_chunks(), path)


def write_tasks(path: Path, tasks: Sequence[str]) -> None:
    """Write the tasks as version 3.0 has them: a data frame of pandas whose index is the text."""
    import pyarrow as pa
    from pyarrow import parquet

    index = "__index_level_0__"
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), index: pa.array(tasks, pa.string())})
    described: list[dict[str, Any]] = [
        {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"},
        {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object"},
    ]
    pandas: dict[str, Any] = {
        "index_columns": [index],
        "column_indexes": [],
        "columns": [{**each, "metadata": None} for each in described],
        "pandas_version": "2.0.0",
    }
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), path)


_CODEC = "mp4v"


class VideoNotWritten(VitacError):
    """OpenCV cannot write a video here; install its own build, with FFmpeg."""


class VideoFile:
    """A video that is written.

    Args:
        path: of the file.
        fps: pictures per second.
        size: height and width [px].

    Raises:
        VideoNotWritten: OpenCV cannot.
    """

    def __init__(self, path: Path, *, fps: float, size: tuple[int, int]) -> None:
        import cv2

        path.parent.mkdir(parents=True, exist_ok=True)
        code = cv2.VideoWriter.fourcc(*_CODEC)
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, fps, size[::-1])
        if not self._writer.isOpened():
            raise VideoNotWritten(
                f"{path} cannot be written, because OpenCV has no encoder for {_CODEC}; expected "
                "opencv-python-headless. Install that."
            )

    def add(self, pictures: Iterable[NDArray[np.uint8]]) -> None:
        """Add pictures in red, green and blue, shape [h, w, 3] each."""
        for picture in pictures:
            self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def close(self) -> None:
        """Write what is left."""
        self._writer.release()


def measure_video(path: Path) -> tuple[int, float]:
    """Return the number of pictures and the pictures per second; 0 pictures where it is no video."""
    import cv2

    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        count = 0
        while video.isOpened() and video.grab():
            count += 1
        return count, float(video.get(cv2.CAP_PROP_FPS))
    finally:
        video.release()


def write_lerobot(
    folder: Path,
    version: Version,
    source: Source,
    features: Sequence[Feature],
    frames: Iterable[Frames],
    *,
    fps: float,
) -> None:
    """Write a data set of episodes as they were seen.

    Args:
        folder: of the data set.
        version: of the format.
        source: where the demonstrations come from.
        features: columns and videos.
        frames: of every episode.
        fps: env steps in a second of video.

    Raises:
        NotSaved: a file cannot be written.
        VideoNotWritten: OpenCV cannot.
    """
    writer = _Writer(folder, version, source, features, fps=fps)
    for each in frames:
        writer.add(each)
    writer.finish()


class _Writer:
    """Writes one episode after the other."""

    def __init__(
        self, folder: Path, version: Version, source: Source, features: Sequence[Feature], *, fps: float
    ) -> None:
        self._folder, self._version, self._source, self._fps = folder, version, source, fps
        self._features = features
        self._columns = [feature for feature in features if feature.dtype != "video"]
        self._cameras = [feature for feature in features if feature.dtype == "video"]
        self._task = source.task.title
        self._episodes: list[dict[str, Any]] = []
        self._total = Total()
        self._frames = self._files = 0
        self._file: list[Mapping[str, pa.Array]] = []
        self._videos: dict[str, VideoFile] = {}

    def add(self, frames: Frames) -> None:
        """Add an episode."""
        values = self._values(frames)
        statistics = describe_episode(values, self._features)
        self._total.add(statistics)
        self._episodes.append({**self._place(len(frames.actions)), "statistics": statistics})
        self._file.append({feature.name: make_column(values[feature.name], feature) for feature in self._columns})
        for camera in self._cameras:
            self._video(camera).add(values[camera.name])
        self._frames += len(frames.actions)
        if len(self._file) == self._version.episodes_of_a_file:
            self._end_file()

    def finish(self) -> None:
        """Write what describes the data set."""
        if self._file:
            self._end_file()
        info = make_info(
            self._version,
            self._features,
            fps=self._fps,
            episodes=len(self._episodes),
            frames=self._frames,
            files=self._files,
        )
        write_text(self._folder / INFO, json.dumps(info, indent=4) + "\n")
        write_text(self._folder / STATS, json.dumps(as_lists(self._total.result()), indent=4) + "\n")
        if self._version is Version.V2_1:
            self._write_lines()
        else:
            self._write_episodes()

    def _values(self, frames: Frames) -> dict[str, Any]:
        """Return the entries of all columns for an episode; what was seen after its last action is left out."""
        length = len(frames.actions)
        last = np.arange(length) == length - 1
        indices = np.arange(length, dtype=np.int64)
        seen = {
            feature.name: feature.read(*observed) if feature.read else observed[0]
            for feature in self._features
            if (observed := [frames.observations[key][:-1] for key in feature.keys])
        }
        return {
            **seen,
            "action": frames.actions,
            "next.reward": frames.rewards,
            "next.done": last,
            "next.success": last & frames.demonstration.is_success,
            STATE_HASH: frames.demonstration.state_hashes[:-1],
            "timestamp": (indices / self._fps).astype(np.float32),
            "frame_index": indices,
            "episode_index": np.full(length, len(self._episodes), dtype=np.int64),
            "index": self._frames + indices,
            "task_index": np.zeros(length, dtype=np.int64),
        }

    def _place(self, length: int) -> dict[str, Any]:
        """Return where the next episode is found."""
        chunk, file = divmod(self._files, FILES_OF_A_CHUNK)
        within = sum(len(each["index"]) for each in self._file) / self._fps
        videos: dict[str, Any] = {}
        for camera in self._cameras:
            start = f"videos/{camera.name}/"
            videos |= {f"{start}chunk_index": chunk, f"{start}file_index": file}
            videos |= {f"{start}from_timestamp": within, f"{start}to_timestamp": within + length / self._fps}
        return {
            "episode_index": len(self._episodes),
            "tasks": [self._task],
            "length": length,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + length,
            **videos,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }

    def _video(self, camera: Feature) -> VideoFile:
        if camera.name not in self._videos:
            path = self._folder / format_path(self._version.video_path, self._files, camera.name)
            height_px, width_px, _ = camera.shape
            self._videos[camera.name] = VideoFile(path, fps=self._fps, size=(height_px, width_px))
        return self._videos[camera.name]

    def _end_file(self) -> None:
        write_table(self._folder / format_path(self._version.data_path, self._files), self._file)
        for video in self._videos.values():
            video.close()
        self._file, self._videos, self._files = [], {}, self._files + 1

    def _write_lines(self) -> None:
        """Write the descriptions of version 2.1."""
        own = ("episode_index", "tasks", "length")
        rows = [{name: episode[name] for name in own} for episode in self._episodes]
        lines = [
            {"episode_index": episode["episode_index"], "stats": as_lists(episode["statistics"])}
            for episode in self._episodes
        ]
        meta = self._folder / "meta"
        _write_json_lines(meta / "episodes.jsonl", rows)
        _write_json_lines(meta / "episodes_stats.jsonl", lines)
        _write_json_lines(meta / "tasks.jsonl", [{"task_index": 0, "task": self._task}])

    def _write_episodes(self) -> None:
        """Write the descriptions of version 3.0."""
        rows = []
        for episode in self._episodes:
            statistics = as_lists(episode.pop("statistics"))
            flat = {f"stats/{name}/{key}": value for name, each in statistics.items() for key, value in each.items()}
            rows.append(episode | flat)
        write_table(self._folder / "meta/episodes/chunk-000/file-000.parquet", rows)
        write_tasks(self._folder / "meta/tasks.parquet", [self._task])


def _write_json_lines(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    write_text(path, "".join(json.dumps(row) + "\n" for row in rows))
