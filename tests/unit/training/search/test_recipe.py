"""Recipes of a search: what may be said, and how a mistake is named."""

from pathlib import Path

import pytest
from vitac.evaluator.strict_model import DocumentRejected
from vitac.training.search.method import SearchRecipe, read_search_recipe


def read(tmp_path: Path, text: str) -> SearchRecipe:
    path = tmp_path / "recipe.yaml"
    path.write_text(text)
    return read_search_recipe(path)


def test_task_and_seed_are_enough(tmp_path: Path) -> None:
    recipe = read(tmp_path, "task: lock-opening\nseed: 3\n")
    assert (recipe.task, recipe.seed) == ("lock-opening", 3)
    assert recipe.kept <= recipe.candidates


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("task: lock-opening\n", "Missing key 'seed'"),
        ("task: lock-opening\nseed: 3\ngeneration: 2\n", "Unknown key 'generation'; did you mean 'generations'"),
        ("task: fusion-insertion\nseed: 3\n", "task: Input should be 'lock-opening'"),
        ("task: peg-insertion\nrounds: 3\n", r"trained in rounds; run `vitac train` with this recipe\.$"),
        ("task: lock-opening\nseed: -1\n", "seed: Input should be greater than or equal to 0"),
        ("task: lock-opening\nseed: 3\ncandidates: 4\nkept: 5\n", "'kept' is 5, expected at most .* candidates, 4"),
        ("task: lock-opening\nseed: 3\nepisodes: 0\n", "episodes: Input should be greater"),
        ("", "recipe.yaml"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(DocumentRejected, match=told):
        read(tmp_path, text)
