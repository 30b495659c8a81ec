"""The challenge's method where its packages may be missing."""

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from vitac.training import run
from vitac.training.files import NotSaved, write_text
from vitac.training.reference import method
from vitac.training.reference.method import (
    TrainingPackagesMissing,
    UnknownReferenceTask,
    hyperparameters,
    require_packages,
    train_reference,
)
from vitac.training.run import OtherRun
from vitac.training.streams import StreamRefused


def test_missing_packages_are_named_with_how_to_install_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method, "find_spec", lambda name: None if name == "torch" else object())
    with pytest.raises(TrainingPackagesMissing, match=r"needs torch, expected to be installed.*pip install .*torch"):
        require_packages()
    monkeypatch.setattr(method, "find_spec", lambda _: None)
    with pytest.raises(TrainingPackagesMissing, match="needs torch and stable_baselines3"):
        require_packages()
    monkeypatch.setattr(method, "find_spec", lambda _: object())
    require_packages()


def test_nothing_is_written_where_packages_are_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method, "find_spec", lambda _: None)
    with pytest.raises(TrainingPackagesMissing):
        train_reference("peg-insertion", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_unknown_task_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownReferenceTask, match="The task is 'chess', expected one of peg-insertion, lock-opening"):
        train_reference("chess", tmp_path)


def test_seed_is_the_only_thing_that_is_chosen() -> None:
    assert hyperparameters("peg-insertion", 7).seed == 7
    assert hyperparameters("peg-insertion").env_steps == 400_000


@pytest.fixture
def during_training(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], object]], None]:
    """Has a training do something in place of TD3, which needs no packages."""

    def does(something: Callable[[], object]) -> None:
        def train(task: str, chosen: object, make: object, folder: Path, env_steps: int, tell: object) -> Path:
            something()
            (folder / "model.zip").write_bytes(b"model")
            return folder / "model.zip"

        monkeypatch.setitem(sys.modules, "vitac.training.reference.td3", SimpleNamespace(train=train))

    monkeypatch.setattr(method, "require_packages", lambda: None)
    monkeypatch.setattr(method, "version", lambda _: "1")
    does(lambda: None)
    return does


def refused(folder: Path) -> None:
    with pytest.raises(OtherRun, match=r"Another process trains in .*run; wait for it, or give another folder"):
        train_reference("peg-insertion", folder)


def test_a_folder_is_taken_before_anything_in_it_is_looked_at_written_or_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, during_training: Callable[[Callable[[], object]], None]
) -> None:
    claimed, claim_folder = [], run._claim

    def claim(folder: Path, recipe: dict[str, object]) -> None:
        claimed.append(folder)
        refused(folder)
        claim_folder(folder, recipe)

    monkeypatch.setattr(run, "_claim", claim)
    assert (train_reference("peg-insertion", tmp_path / "run") / "Track_1" / "submission.yaml").exists()
    assert claimed == [tmp_path / "run"], "the second one got no further"


def test_a_folder_stays_taken_where_its_files_are_replaced_and_is_free_at_the_end(
    tmp_path: Path, during_training: Callable[[Callable[[], object]], None]
) -> None:
    folder = tmp_path / "run"

    def replace_and_try() -> None:
        told = (folder / "run.json").read_text()
        write_text(folder / "run.json", told)
        half = folder / ".state.npz.999999999.new"
        half.write_bytes(b"written by a process of another container")
        refused(folder)
        assert half.exists()

    during_training(replace_and_try)
    train_reference("peg-insertion", folder)
    during_training(lambda: None)
    train_reference("peg-insertion", folder)


def test_nothing_is_written_for_a_seed_whose_stream_an_official_list_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, during_training: Callable[[Callable[[], object]], None]
) -> None:
    monkeypatch.setattr("vitac.training.streams.FIRST_STREAM", 0)
    for seed, refusal in ((0, "Seed 0 is that of the official list of peg-insertion"), (-1, "The seed is -1")):
        with pytest.raises(StreamRefused, match=refusal):
            train_reference("peg-insertion", tmp_path / "run", seed=seed)
    assert not (tmp_path / "run").exists()


def test_a_folder_is_taken_until_the_submission_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, during_training: Callable[[Callable[[], object]], None]
) -> None:
    submission = method._submission

    def refused_meanwhile(task: str, model: Path, folder: Path) -> Path:
        refused(tmp_path / "run")
        return submission(task, model, folder)

    monkeypatch.setattr(method, "_submission", refused_meanwhile)
    assert (train_reference("peg-insertion", tmp_path / "run") / "Track_1" / "peg-insertion.zip").exists()


def test_a_file_system_without_locks_is_told_and_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, during_training: Callable[[Callable[[], object]], None]
) -> None:
    def flock(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(run, "flock", flock)
    told: list[str] = []
    assert train_reference("peg-insertion", tmp_path / "run", tell=told.append).exists()
    [line] = told
    assert line.endswith("run takes no lock (No locks available); make sure that no other process trains there")


def test_a_folder_that_cannot_be_made_is_told(
    tmp_path: Path, during_training: Callable[[Callable[[], object]], None]
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NotSaved, match=r"\.lock cannot be written \(Not a directory\); give a folder"):
        train_reference("peg-insertion", tmp_path / "file" / "run")
