"""docs/builder/notebooks.py: the tutorial starts afresh, and its results are kept for one version of the code."""

from pathlib import Path

import pytest
import vitac.training
from notebooks import code_version, kept_results, remove_leftovers
from vitac.evaluator import version


def test_what_an_earlier_run_left_is_removed_and_the_notebook_stays(tmp_path: Path) -> None:
    folder = tmp_path / "tutorials" / "train_a_policy"
    (folder / "tutorial_run" / "episodes").mkdir(parents=True)
    (folder / "tutorial_run" / "episodes" / "1.npz").touch()
    (folder / "tutorial_recipe.yaml").touch()
    (folder / "train_a_policy.ipynb").write_text("{}")
    remove_leftovers(tmp_path)
    assert [path.name for path in folder.iterdir()] == ["train_a_policy.ipynb"]
    remove_leftovers(tmp_path / "absent")


def test_results_of_other_versions_are_removed(tmp_path: Path) -> None:
    assert kept_results(tmp_path / "absent", "new") == tmp_path / "absent" / "new"
    for name in ("old", "new"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "result").touch()
    assert kept_results(tmp_path, "new") == tmp_path / "new"
    assert [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("result")] == ["new/result"]


def test_the_version_of_results_follows_evaluator_and_training(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = code_version()
    assert before == code_version()
    monkeypatch.setattr(version, "evaluator_hash", lambda: "0" * 64)
    other_evaluator = code_version()
    (tmp_path / "policy.py").write_text("changed = True")
    monkeypatch.setattr(vitac.training.__spec__, "submodule_search_locations", [str(tmp_path)])
    assert len({before, other_evaluator, code_version()}) == 3


def test_the_tutorial_is_the_example_and_has_beside_it_what_it_plays_against(repository: Path) -> None:
    tutorial = repository / "docs" / "tutorials" / "train_a_policy" / "train_a_policy.ipynb"
    assert (repository / "examples" / "train_a_policy" / tutorial.name).resolve() == tutorial.resolve()
    assert (tutorial.parents[1] / "peg_insertion_heuristic" / "Track_1" / "policy.py").is_file()
