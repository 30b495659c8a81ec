"""The challenge's method where its packages may be missing."""

from pathlib import Path

import pytest
from vitac.training.reference import method
from vitac.training.reference.method import (
    TrainingPackagesMissing,
    UnknownReferenceTask,
    hyperparameters,
    require_packages,
    train_reference,
)


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
