"""Finds what is broken in a LeRobotDataset, whoever wrote it: each fault with its file, its row and what to do."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .layout import INDICES, INFO, STATS, Version, format_path
from .writing import measure_video

_TIME_TOLERANCE_S = 1e-4
"""How far a time may be from its frame; that of LeRobot."""
_ARROW_NAMES = {"float32": "float", "float64": "double"}
_NEEDED = ("codebase_version", "total_episodes", "total_frames", "total_tasks", "fps", "data_path", "features")
AGAIN = "Fetch it or export the data set again."


@dataclass(frozen=True, kw_only=True)
class DatasetFault:
    """What is wrong with a data set.

    Attributes:
        file: in its folder.
        row: of the table in this file, from 0; None where it is the file.
        problem: what was expected, and what is there.
        remedy: what to do.
    """

    file: str
    row: int | None = None
    problem: str
    remedy: str = AGAIN

    def __str__(self) -> str:
        place = self.file if self.row is None else f"{self.file}: row {self.row}"
        return f"{place}: {self.problem} {self.remedy}"


class _Broken(Exception):
    """A fault after which a file cannot be looked at further."""

    def __init__(self, file: Path | str, problem: str, remedy: str = AGAIN) -> None:
        self.fault = DatasetFault(file=str(file), problem=problem, remedy=remedy)


@dataclass(frozen=True, kw_only=True)
class _File:
    """A table, and the episodes in it.

    Attributes:
        name: of the file.
        number: counted over all chunks.
        first_episode: index of its first episode.
        first_row: index of its first row.
        lengths: rows of each episode.
    """

    name: str
    number: int
    first_episode: int
    first_row: int
    lengths: tuple[int, ...]


def check_lerobot(folder: Path) -> Iterator[DatasetFault]:
    """Yield the faults of a data set: of every column of a file the first row, and of every video.

    Pictures are counted, not looked at.
    """
    try:
        info = _read_info(folder)
        files = _list_files(folder, info)
    except _Broken as broken:
        yield broken.fault
        return
    if not (folder / STATS).exists() and info["codebase_version"] == Version.V3_0:
        yield DatasetFault(file=str(STATS), problem="is missing, expected the statistics of all columns.")
    for file in files:
        yield from _check_table(folder, info, file)
        yield from _check_videos(folder, info, file)


def _read_info(folder: Path) -> dict[str, Any]:
    info = _read_json(folder, INFO)
    missing = [name for name in _NEEDED if name not in info]
    if missing:
        raise _Broken(INFO, f"has no {missing[0]!r}, expected {', '.join(_NEEDED)}.")
    if info["codebase_version"] not in list(Version):
        known = " or ".join(Version)
        raise _Broken(INFO, f"codebase_version is {info['codebase_version']!r}, expected {known}.", "Convert it first.")
    return info


def _read_json(folder: Path, name: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / name).read_text())
    except OSError as error:
        raise _Broken(name, f"cannot be read ({error.strerror}), expected a LeRobotDataset.") from error
    except ValueError as error:
        raise _Broken(name, f"is no JSON ({error}).") from error
    if not isinstance(content, dict):
        raise _Broken(name, f"is a {type(content).__name__}, expected an object.")
    return content


def _list_files(folder: Path, info: Mapping[str, Any]) -> list[_File]:
    version, size = Version(info["codebase_version"]), int(info.get("chunks_size", 1000))
    described = list(_describe_episodes(folder, version, size))
    if len(described) != info["total_episodes"]:
        raise _Broken(
            INFO,
            f"total_episodes is {info['total_episodes']}, but {len(described)} are described in meta.",
            "Correct the number, or fetch the descriptions that are missing.",
        )
    frames = sum(length for _, length in described)
    if frames != info["total_frames"]:
        raise _Broken(
            INFO, f"total_frames is {info['total_frames']}, but the episodes have {frames}.", "Correct the number."
        )
    listed: list[_File] = []
    row = 0
    for number in sorted({file for file, _ in described}):
        episodes = [index for index, (file, _) in enumerate(described) if file == number]
        lengths = tuple(described[index][1] for index in episodes)
        name = format_path(info["data_path"], number, chunk_size=size)
        listed.append(_File(name=name, number=number, first_episode=episodes[0], first_row=row, lengths=lengths))
        row += sum(lengths)
    return listed


def _describe_episodes(folder: Path, version: Version, chunk_size: int) -> Iterator[tuple[int, int]]:
    """Yield number of the file, counted over all chunks, and length of each episode."""
    if version is Version.V2_1:
        name = Path("meta/episodes.jsonl")
        try:
            lines = (folder / name).read_text().splitlines()
            lengths = [int(json.loads(line)["length"]) for line in lines]
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise _Broken(name, f"cannot be read ({error}), expected the length of every episode.") from error
        yield from enumerate(lengths)
        return
    names = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    if not names:
        raise _Broken("meta/episodes", "has no table, expected the descriptions of the episodes.")
    for path in names:
        table = _read_table(folder, str(path.relative_to(folder)))
        try:
            columns = [table[name].to_pylist() for name in ("data/chunk_index", "data/file_index", "length")]
        except KeyError as error:
            raise _Broken(path.relative_to(folder), f"has no column {error}.") from error
        yield from ((chunk * chunk_size + file, length) for chunk, file, length in zip(*columns, strict=True))


def _read_table(folder: Path, name: str) -> Any:
    import pyarrow as pa
    from pyarrow import parquet

    try:
        return parquet.read_table(folder / name)
    except FileNotFoundError as error:
        raise _Broken(name, "is missing.") from error
    except (OSError, pa.ArrowException) as error:
        raise _Broken(name, f"is no whole Parquet file ({str(error).splitlines()[0]}).") from error


def _check_table(folder: Path, info: Mapping[str, Any], file: _File) -> Iterator[DatasetFault]:
    try:
        table = _read_table(folder, file.name)
    except _Broken as broken:
        yield broken.fault
        return
    rows = sum(file.lengths)
    if table.num_rows != rows:
        problem = f"has {table.num_rows} rows, but its episodes have {rows}."
        yield DatasetFault(file=file.name, row=min(rows, table.num_rows), problem=problem)
        return
    expected = _expected_indices(file, info["fps"])
    described = {feature.name: {"dtype": feature.dtype, "shape": feature.shape} for feature in INDICES}
    for name, feature in (described | info["features"]).items():
        if feature["dtype"] in ("video", "image"):
            continue
        if name not in table.column_names:
            yield DatasetFault(file=file.name, problem=f"has no column {name!r}, but info.json names it.")
            continue
        try:
            values = _values(file, name, table[name], feature)
        except _Broken as broken:
            yield broken.fault
            continue
        yield from _check_values(file, name, values, expected.get(name), info)


def _expected_indices(file: _File, fps: float) -> dict[str, NDArray[Any]]:
    frames = np.concatenate([np.arange(length) for length in file.lengths])
    return {
        "timestamp": frames / fps,
        "frame_index": frames,
        "episode_index": file.first_episode + np.repeat(np.arange(len(file.lengths)), file.lengths),
        "index": file.first_row + np.arange(len(frames)),
    }


def _values(file: _File, name: str, column: Any, feature: Mapping[str, Any]) -> NDArray[Any]:
    """Return the numbers of a column, shape [rows, numbers]; texts as they are."""
    import pyarrow as pa

    values, kind = column.combine_chunks(), column.type
    while isinstance(kind, pa.ListType | pa.LargeListType | pa.FixedSizeListType):
        values, kind = values.flatten(), kind.value_type
    wanted = _ARROW_NAMES.get(feature["dtype"], feature["dtype"])
    if str(kind) != wanted:
        raise _Broken(file.name, f"column {name!r} has type {kind}, expected {wanted} as in info.json.")
    numbers, rows = prod(feature["shape"]), len(column)
    if values.null_count or len(values) != numbers * rows:
        problem = (
            f"column {name!r} has {len(values) - values.null_count} numbers, expected {numbers} in each of {rows} rows."
        )
        raise _Broken(file.name, problem)
    array: NDArray[Any] = values.to_numpy(zero_copy_only=False).reshape(rows, numbers)
    return array


def _check_values(
    file: _File, name: str, values: NDArray[Any], expected: NDArray[Any] | None, info: Mapping[str, Any]
) -> Iterator[DatasetFault]:
    """Yield the first row that is wrong."""
    if values.dtype.kind == "f" and (row := _first(~np.isfinite(values).all(axis=1))) is not None:
        number = values[row][~np.isfinite(values[row])][0]
        remedy = "Repair the number or leave the episode out."
        yield DatasetFault(
            file=file.name, row=row, problem=f"column {name!r} is {number}, expected a number.", remedy=remedy
        )
    elif expected is not None:
        tolerance = _TIME_TOLERANCE_S if name == "timestamp" else 0
        row = _first(np.abs(values[:, 0] - expected) > tolerance)
        if row is not None:
            why = f", a frame every 1/{info['fps']:g} s as info.json says" if name == "timestamp" else ""
            problem = f"column {name!r} is {values[row, 0]:g}, expected {expected[row]:g}{why}."
            yield DatasetFault(
                file=file.name, row=row, problem=problem, remedy="Number the rows again, or correct fps."
            )
    elif (
        name == "task_index" and (row := _first((values[:, 0] < 0) | (values[:, 0] >= info["total_tasks"]))) is not None
    ):
        problem = f"column 'task_index' is {values[row, 0]}, but there are {info['total_tasks']} tasks."
        yield DatasetFault(file=file.name, row=row, problem=problem, remedy="Describe the task in meta.")


def _first(wrong: NDArray[np.bool_]) -> int | None:
    return int(wrong.argmax()) if wrong.any() else None


def _check_videos(folder: Path, info: Mapping[str, Any], file: _File) -> Iterator[DatasetFault]:
    cameras: Sequence[str] = [name for name, feature in info["features"].items() if feature["dtype"] == "video"]
    for camera in cameras:
        name = format_path(info["video_path"], file.number, camera, chunk_size=int(info.get("chunks_size", 1000)))
        if not (folder / name).exists():
            yield DatasetFault(file=name, problem="is missing.")
            continue
        count, fps = measure_video(folder / name)
        rows = sum(file.lengths)
        if count < rows:
            problem = f"has {count} pictures, but {file.name} has {rows} rows; there is none for this row."
            yield DatasetFault(file=name, row=count, problem=problem)
        elif abs(fps - info["fps"]) > 1e-3 * info["fps"]:
            problem = f"has {fps:g} pictures per second, expected {info['fps']:g} as in info.json."
            yield DatasetFault(file=name, problem=problem, remedy="Correct fps, or write the video again.")
