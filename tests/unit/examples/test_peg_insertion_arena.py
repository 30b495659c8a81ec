"""The peg policy trained under arena-2: it is what its recipe makes, and its card tells what was measured."""

import json
from pathlib import Path
from typing import Any

from vitac.envs.fem.model.settings import ContactModel
from vitac.evaluator.submission.manifest import load_manifest
from vitac.training.recipe import read_recipe

EXAMPLE = "peg_insertion_arena"


def test_is_a_valid_submission_with_the_policy_of_the_training(example: Path, repository: Path) -> None:
    manifest = load_manifest(example / "Track_1")
    assert (manifest.track, manifest.tasks) == ("track_1_peg_robust", ("peg-insertion-robust",))
    trained = repository / "training" / "submission" / "policy.py"
    assert (example / "Track_1" / "policy.py").read_bytes() == trained.read_bytes()


def test_log_is_that_of_its_recipe_and_card_tells_the_measured_figures(example: Path, figures: dict[str, Any]) -> None:
    recipe = read_recipe(example / "recipe.yaml")
    assert recipe.contact_model is ContactModel.ARENA_2
    rows = [json.loads(line) for line in (example / "log.jsonl").read_text().splitlines()]
    assert len(rows) == recipe.rounds
    card = (example / "README.md").read_text()
    for row in rows:
        solved = f"{row['student']['successes']} of 120 | {row['critic']['successes']} of 120 | {row['env_steps']}"
        assert f"| {row['round']} | {solved} |" in card
    for name, played in figures.items():
        low, high = (100 * played["interval"][end] for end in ("low", "high"))
        assert f"{100 * played['success_rate']:.1f} % [{low:.1f}, {high:.1f}]" in card, name
