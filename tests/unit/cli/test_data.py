"""`vitac data` as it is typed."""

import json
from pathlib import Path

import pytest
from seen_episodes import write_data_set
from vitac.cli.main import main
from vitac.training.demonstrations.lerobot.layout import Version

pytest.importorskip("pyarrow", reason="needs the extra `data`")


def run(*arguments: object) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


def test_check_says_what_is_broken_and_exits_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_data_set(tmp_path / "set", Version.V3_0)
    assert run("data", "check", tmp_path / "set") == 0
    assert capsys.readouterr().out == "no fault found; 0 episodes replayed\n"
    (tmp_path / "set/data/chunk-000/file-000.parquet").unlink()
    assert run("data", "check", tmp_path / "set", "--json") == 1
    assert json.loads(capsys.readouterr().out)["faults"] == [
        "data/chunk-000/file-000.parquet: is missing. Fetch it or export the data set again."
    ]


def test_import_of_a_broken_set_and_export_of_nothing_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("data", "import", tmp_path, "--to", tmp_path / "back") == 1
    assert "expected what `vitac data export` writes" in capsys.readouterr().err
    assert run("data", "export", tmp_path, "--to", tmp_path / "new") == 2
    assert not (tmp_path / "new").exists()
