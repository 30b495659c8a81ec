"""The tutorial runs as it stands, in miniature and with the real physics."""

import json
from pathlib import Path
from typing import Any

import pytest
from vitac.evaluator.submission.manifest import load_manifest
from vitac.training.recipe import read_recipe


@pytest.fixture(scope="module")
def notebook(repository: Path) -> dict[str, Any]:
    path = repository / "examples" / "train_a_policy" / "train_a_policy.ipynb"
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def code_of(notebook: dict[str, Any]) -> list[str]:
    return ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_notebook_is_stored_without_results(notebook: dict[str, Any]) -> None:
    assert notebook["nbformat"] == 4
    for cell in notebook["cells"]:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None


@pytest.mark.slow
def test_every_cell_runs_and_a_submission_comes_of_it(
    notebook: dict[str, Any], repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heuristic = "peg_insertion_heuristic"
    (tmp_path / heuristic).symlink_to(repository / "examples" / heuristic)
    folder = tmp_path / "train_a_policy"
    folder.mkdir()
    monkeypatch.setenv("VITAC_TUTORIAL", "small")
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {"__name__": "tutorial"}
    for number, cell in enumerate(code_of(notebook)):
        exec(compile(cell, f"cell {number}", "exec"), names)  # noqa: S102 - the notebook's own code
    assert [result.number for result in names["results"]] == [1, 2]
    assert load_manifest(folder / "tutorial_submission" / "Track_1").tasks == ("peg-insertion",)
    assert {name: score.episodes for name, score in names["scores"].items()} == {"trained": 2, "heuristic": 2}


def test_recipe_of_the_real_run_is_a_valid_one(notebook: dict[str, Any], tmp_path: Path) -> None:
    cell = next(cell for cell in code_of(notebook) if "SMALL" in cell and "seed: 5" in cell)
    path = tmp_path / "recipe.yaml"
    path.write_text(cell.split('"""')[3])
    recipe = read_recipe(path)
    assert (recipe.rounds, recipe.assessed_from) == (3, 2)
