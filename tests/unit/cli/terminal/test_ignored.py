from pathlib import Path

import pytest
from vitac.cli.terminal.output import note_ignored_folders


def test_the_folder_of_another_track_beside_the_submission_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for top in ("Track_1", "Track_2"):
        note_ignored_folders(tmp_path)
        assert capsys.readouterr().err == ""
        (tmp_path / top).mkdir()
        (tmp_path / top / "submission.yaml").touch()
    note_ignored_folders(tmp_path)
    taken = tmp_path / "Track_1"
    assert capsys.readouterr().err == (
        f"vitac: takes {taken}; Track_2 beside it is ignored: name that folder to take it\n"
    )
    note_ignored_folders(taken)
    assert capsys.readouterr().err == ""
