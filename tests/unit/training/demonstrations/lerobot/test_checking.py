"""A broken data set is named with file and row."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seen_episodes import CAMERA, write_data_set
from vitac.training.demonstrations.lerobot.checking import check_lerobot
from vitac.training.demonstrations.lerobot.layout import INFO, Version
from vitac.training.demonstrations.lerobot.writing import VideoFile

pytest.importorskip("pyarrow", reason="needs the extra `data`")

V2, V3 = Version.V2_1, Version.V3_0
FILE_2 = "data/chunk-000/episode_000001.parquet"
FILE_3 = "data/chunk-000/file-000.parquet"
VIDEO_3 = f"videos/{CAMERA}/chunk-000/file-000.mp4"
Break = Callable[[Path], None]


def change(file: str, column: str, row: int, value: Any, dtype: str | None = None) -> Break:
    """Return what changes one entry of a column, and its type."""

    def apply(folder: Path) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        table = parquet.read_table(folder / file)
        values = table[column].to_pylist()
        values[row] = value
        position = table.column_names.index(column)
        kind = pa.type_for_alias(dtype) if dtype else table[column].type
        parquet.write_table(table.set_column(position, column, pa.array(values, kind)), folder / file)

    return apply


def rename(file: str, old: str, new: str) -> Break:
    def apply(folder: Path) -> None:
        from pyarrow import parquet

        table = parquet.read_table(folder / file)
        names = [new if name == old else name for name in table.column_names]
        parquet.write_table(table.rename_columns(names), folder / file)

    return apply


def cut(file: str) -> Break:
    def apply(folder: Path) -> None:
        (folder / file).write_bytes((folder / file).read_bytes()[:-100])

    return apply


def lose(file: str) -> Break:
    return lambda folder: (folder / file).unlink()


def say(**changed: Any) -> Break:
    def apply(folder: Path) -> None:
        info = json.loads((folder / INFO).read_text())
        (folder / INFO).write_text(json.dumps(info | changed))

    return apply


def film(pictures: int, fps: float) -> Break:
    def apply(folder: Path) -> None:
        video = VideoFile(folder / VIDEO_3, fps=fps, size=(32, 48))
        video.add(np.zeros((pictures, 32, 48, 3), dtype=np.uint8))
        video.close()

    return apply


BROKEN = [
    pytest.param(V3, change(FILE_3, "index", 4, 7), f"{FILE_3}: row 4: column 'index' is 7, expected 4", id="index"),
    pytest.param(
        V2, change(FILE_2, "frame_index", 1, 0), f"{FILE_2}: row 1: column 'frame_index' is 0, expected 1", id="frame"
    ),
    pytest.param(
        V3,
        change(FILE_3, "episode_index", 3, 0),
        f"{FILE_3}: row 3: column 'episode_index' is 0, expected 1",
        id="episode",
    ),
    pytest.param(
        V3,
        change(FILE_3, "observation.state", 6, [0.0, float("nan"), 0.0]),
        f"{FILE_3}: row 6: column 'observation.state' is nan",
        id="nan",
    ),
    pytest.param(V3, change(FILE_3, "task_index", 2, 5), f"{FILE_3}: row 2: column 'task_index' is 5", id="task"),
    pytest.param(
        V3,
        change(FILE_3, "privileged.shape", 0, 1.0, "double"),
        f"{FILE_3}: column 'privileged.shape' has type double, expected float",
        id="type",
    ),
    pytest.param(V3, rename(FILE_3, "action", "actions"), f"{FILE_3}: has no column 'action'", id="column"),
    pytest.param(V3, lose(FILE_3), f"{FILE_3}: is missing", id="chunk"),
    pytest.param(V2, lose(FILE_2), f"{FILE_2}: is missing", id="chunk of version 2.1"),
    pytest.param(V3, cut(FILE_3), f"{FILE_3}: is no whole Parquet file", id="truncated"),
    pytest.param(V3, lose(VIDEO_3), f"{VIDEO_3}: is missing", id="video"),
    pytest.param(V3, film(8, 4.0), f"{VIDEO_3}: row 8: has 8 pictures, but {FILE_3} has 10 rows", id="short video"),
    pytest.param(V3, film(10, 5.0), f"{VIDEO_3}: has 5 pictures per second, expected 4", id="video's rate"),
    pytest.param(
        V3, say(fps=5), f"{FILE_3}: row 1: column 'timestamp' is 0.25, expected 0.2, a frame every 1/5 s", id="rate"
    ),
    pytest.param(V3, say(total_episodes=4), f"{INFO}: total_episodes is 4, but 3 are described", id="episodes"),
    pytest.param(V2, say(total_frames=11), f"{INFO}: total_frames is 11, but the episodes have 10", id="frames"),
    pytest.param(V3, say(codebase_version="v1.6"), f"{INFO}: codebase_version is 'v1.6', expected v2.1", id="version"),
    pytest.param(V3, lose("meta/stats.json"), "meta/stats.json: is missing", id="statistics"),
    pytest.param(V3, lose(str(INFO)), f"{INFO}: cannot be read", id="no info"),
    pytest.param(V3, cut(str(INFO)), f"{INFO}: is no JSON", id="info"),
    pytest.param(V2, cut("meta/episodes.jsonl"), "meta/episodes.jsonl: cannot be read", id="descriptions"),
    pytest.param(
        V3, lose("meta/episodes/chunk-000/file-000.parquet"), "meta/episodes: has no table", id="no descriptions"
    ),
]


@pytest.mark.parametrize(("version", "apply", "said"), BROKEN)
def test_names_file_and_row_of_what_is_broken(tmp_path: Path, version: Version, apply: Break, said: str) -> None:
    write_data_set(tmp_path, version)
    assert list(check_lerobot(tmp_path)) == []
    apply(tmp_path)
    faults = [str(fault) for fault in check_lerobot(tmp_path)]
    assert faults
    assert faults[0].startswith(said)
    assert faults[0].endswith("."), "the last sentence says what to do"
