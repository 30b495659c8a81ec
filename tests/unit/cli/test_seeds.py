import json
from pathlib import Path

import pytest
from vitac.cli import main as cli
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.sealed import read_secret, sealed_track


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as exit_:
        cli.main([*map(str, arguments)])
    out, err = capsys.readouterr()
    assert isinstance(exit_.value.code, int)
    return exit_.value.code, out, err


@pytest.fixture
def commitment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    code, out, _ = run(capsys, "seeds", "new", tmp_path / "secret")
    assert code == 0
    assert read_secret(tmp_path / "secret").hex() not in out
    return out.split()[-1]


def test_a_published_secret_agrees_with_its_commitment(
    tmp_path: Path, commitment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, "seeds", "verify", tmp_path / "secret", "--commitment", commitment.upper(), "--json")
    found = json.loads(out)
    assert (code, found["agrees"], found["commitment"]) == (0, True, commitment)
    sealed = sealed_track(load_track("track_1"), read_secret(tmp_path / "secret"))
    assert found["task_hashes"] == {name: task.digest() for name, task in sealed.tasks.items()}


def test_another_secret_does_not(tmp_path: Path, commitment: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "seeds", "new", tmp_path / "other")[0] == 0
    code, out, _ = run(capsys, "seeds", "verify", tmp_path / "other", "--commitment", commitment)
    assert (code, dict(line.split(None, 1) for line in out.splitlines())["agrees"]) == (1, "no")


def test_refusals_name_what_is_wrong(tmp_path: Path, commitment: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "seeds", "new", tmp_path / "secret")
    assert (code, "Name a new file" in err) == (1, True)
    code, _, err = run(capsys, "seeds", "verify", tmp_path / "none", "--commitment", commitment)
    assert (code, "cannot be read" in err) == (1, True)
    options = ("--commitment", commitment, "--track", "none")
    code, _, err = run(capsys, "seeds", "verify", tmp_path / "secret", *options)
    assert (code, "There is no track 'none'" in err) == (1, True)


def test_a_secret_inside_the_submission_is_refused(
    tmp_path: Path, commitment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert commitment
    (tmp_path / "submission.yaml").write_text("{track: track_1, tasks: [peg-insertion], name: mine}")
    code, _, err = run(capsys, "evaluate", tmp_path, "--secret", tmp_path / "secret")
    assert (code, "lies in the submission" in err) == (2, True)
