"""`vitac check` lists everything that would be refused. In the first test it loads the simulation as a user's does."""

import json
from pathlib import Path

import pytest
from submissions import FILES, MANIFEST, submission_folder, submission_zip
from vitac.cli.main import main


def check(path: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as caught:
        main(["check", str(path), *options])
    return int(caught.value.code or 0), "".join(capsys.readouterr())


def with_files(folder: Path, **files: str) -> Path:
    return submission_folder(folder, {**FILES, **{name.replace("__", "."): text for name, text in files.items()}})


def test_a_good_submission_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = check(submission_folder(tmp_path), capsys)
    assert code == 0
    assert "All checks passed. Content digest" in text
    assert text.count(", outcome ") == 2
    assert "outcome steps. All env steps were used up." in text


@pytest.mark.usefixtures("shared_simulation")
def test_a_submission_of_two_tasks_is_tried_in_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    act = "np.ones({'peg-insertion': 3, 'lock-opening': 2}[self.task], np.float32)"
    policy = (
        "import numpy as np\nclass Policy:\n    def reset(self, task): self.task = task\n"
        f"    def act(self, observation): return {act}\n"
    )
    manifest = MANIFEST.replace("[peg-insertion]", "[peg-insertion, lock-opening]")
    code, text = check(with_files(tmp_path, policy__py=policy, submission__yaml=manifest), capsys)
    assert code == 0
    assert (text.count("peg-insertion, episode"), text.count("lock-opening, episode")) == (2, 2)


@pytest.mark.usefixtures("shared_simulation")
def test_a_zip_and_its_folder_have_the_same_digest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    archive = tmp_path / "s.zip"
    archive.write_bytes(submission_zip())
    _, of_zip = check(archive, capsys, "--json")
    _, of_folder = check(submission_folder(tmp_path / "folder"), capsys, "--json")
    assert json.loads(of_zip) == json.loads(of_folder)


@pytest.mark.usefixtures("shared_simulation")
@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("submission__yaml", MANIFEST.replace("entry_point", "entrypoint"), "did you mean 'entry_point'"),
        ("policy__py", "import nothing_of_that_name", "import_error"),
        ("policy__py", "import torch", "installed packages has it"),
        ("policy__py", "open('weights.npy')", "Files in the submission: policy.py"),
        ("submission__yaml", MANIFEST.replace("policy:Policy", "polcy:Policy"), "Files in the submission: policy.py"),
        ("policy__py", "class Policy:\n    def reset(self, task): 1 / 0", "crashed"),
        ("policy__py", FILES["policy.py"].replace("[0.0, 0.0, 0.0]", "[0.0]"), "bad_action_shape"),
        ("sub/Policy__py", "", None),
        ("Policy__py", "", "differ only in case"),
    ],
)
def test_what_would_be_refused_is_told(
    name: str, text: str, told: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, output = check(with_files(tmp_path, **{name: text}), capsys)
    assert code == (1 if told else 0)
    assert (told or "All checks passed") in output


@pytest.mark.usefixtures("shared_simulation")
def test_output_of_the_policy_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = check(with_files(tmp_path, policy__py="print('loading weights')\nraise OSError('gone')"), capsys)
    assert code == 1
    assert "  | loading weights" in text
    assert "OSError: gone" in text


@pytest.mark.usefixtures("shared_simulation")
def test_links_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (submission_folder(tmp_path) / "link").symlink_to("policy.py")
    code, text = check(tmp_path, capsys, "--json")
    assert code == 1
    assert "is a link" in json.loads(text)["refused"][0]


@pytest.mark.usefixtures("shared_simulation")
def test_what_is_no_submission_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, text = check(tmp_path, capsys)
    assert code == 1
    assert "submission.yaml" in text
