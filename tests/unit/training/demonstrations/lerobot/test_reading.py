"""Demonstrations come back from a data set exactly."""

from pathlib import Path

import pytest
from seen_episodes import SOURCE, write_data_set
from vitac.training.demonstrations.collecting import read_demonstrations, read_source
from vitac.training.demonstrations.frames import ORIGIN, NotOurs, read_origin, write_origin
from vitac.training.demonstrations.lerobot.layout import Version
from vitac.training.demonstrations.lerobot.reading import DataSetBroken, import_lerobot

pytest.importorskip("pyarrow", reason="needs the extra `data`")


@pytest.mark.parametrize("version", list(Version))
def test_demonstrations_come_back_to_the_bit(tmp_path: Path, version: Version) -> None:
    written = write_data_set(tmp_path / "set", version, lengths=(3, 1, *[2] * 51))  # more than a file of v3.0 holds
    path = import_lerobot(tmp_path / "set", tmp_path / "back")
    assert read_source(path) == SOURCE
    assert list(read_demonstrations(path)) == [each.demonstration for each in written]


def test_refuses_what_it_cannot_play_again(tmp_path: Path) -> None:
    write_data_set(tmp_path / "set", Version.V3_0)
    import_lerobot(tmp_path / "set", tmp_path / "back")
    with pytest.raises(NotOurs, match="is there already"):
        import_lerobot(tmp_path / "set", tmp_path / "back")
    (tmp_path / "set" / ORIGIN).unlink()
    with pytest.raises(NotOurs, match="how their episodes started"):
        import_lerobot(tmp_path / "set", tmp_path / "other")


def test_refuses_what_is_broken_and_says_where(tmp_path: Path) -> None:
    write_data_set(tmp_path / "set", Version.V2_1)
    lost = "data/chunk-000/episode_000002.parquet"
    (tmp_path / "set" / lost).unlink()
    with pytest.raises(DataSetBroken, match=f"{lost}: is missing"):
        import_lerobot(tmp_path / "set", tmp_path / "back")


def test_refuses_a_table_with_more_episodes_than_it_says(tmp_path: Path) -> None:
    write_data_set(tmp_path / "set", Version.V2_1)
    origin = read_origin(tmp_path / "set")
    write_origin(tmp_path / "set", origin.model_copy(update={"episodes": origin.episodes[:2]}))
    with pytest.raises(NotOurs, match="other episodes in its table"):
        import_lerobot(tmp_path / "set", tmp_path / "back")
