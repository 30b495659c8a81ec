"""Recipes: what may be said, and how a mistake is named."""

from pathlib import Path

import pytest
from vitac.evaluator.strict_model import DocumentRejected
from vitac.training.recipe import Recipe, read_recipe


def read(tmp_path: Path, text: str) -> Recipe:
    path = tmp_path / "recipe.yaml"
    path.write_text(text)
    return read_recipe(path)


def test_task_and_seed_are_enough(tmp_path: Path) -> None:
    recipe = read(tmp_path, "task: peg-insertion\nseed: 3\n")
    assert (recipe.task, recipe.seed) == ("peg-insertion", 3)


def test_values_reach_the_learners(tmp_path: Path) -> None:
    text = "task: peg-insertion\nseed: 3\ncritic: {hidden: 32, sweeps: 2}\nstudent: {networks: 1, epochs: 5}\n"
    recipe = read(tmp_path, text)
    assert (recipe.critic.hidden, recipe.critic.sweeps) == (32, 2)
    assert (recipe.student.networks, recipe.student.epochs) == (1, 5)


@pytest.mark.parametrize(
    ("draws", "has_images"),
    [
        ("{}", True),
        ("{gripper_x_mm: [-4, 4], clearance_mm: [1, 2]}", True),
        ("{gripper_x_mm: [0.2, 0.4]}", False),
        ("{hole_tilt_y_deg: [-1, 0.5]}", False),
        ("{left_turn_deg: [-1, 1], right_turn_deg: [-1, 1]}", True),
        ("{left_turn_deg: [-1, 1], right_turn_deg: [-2, 2]}", False),
        ("{left_turn_deg: [-1, 1]}", False),
        ("{right_turn_deg: [-1, 1]}", False),
    ],
)
def test_mirror_images_are_learned_from_where_nothing_lies_to_one_side(
    tmp_path: Path, draws: str, has_images: bool
) -> None:
    text = f"task: peg-insertion\nseed: 3\ncontact_model: arena-2\ndraws: {draws}\n"
    assert read(tmp_path, text).has_mirror_images is has_images


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("seed: 3\n", "Missing key 'task'"),
        ("task: peg-insertion\nseed: 3\nround: 2\n", "Unknown key 'round'; did you mean 'rounds'"),
        ("task: peg-insertion\nseed: 3\ncritic: {hiden: 2}\n", "Unknown key 'critic.hiden'; did you mean 'hidden'"),
        ("task: peg-insertion\nseed: 3\ncritic: {rate: 0}\n", "critic.rate: Input should be greater than 0"),
        ("task: chess\nseed: 3\n", "task: Input should be 'peg-insertion'"),
        ("task: peg-insertion\nseed: -1\n", "seed: Input should be greater than or equal to 0"),
        ("task: peg-insertion\nseed: 3\nrounds: 0\n", "rounds: Input should be greater than or equal to 1"),
        ("task: peg-insertion\nseed: 3\nnoise: .nan\n", "noise"),
        ("task: peg-insertion\nseed: 3\ncontact_model: arena-1\n", "contact_model: Input should be .* or 'arena-2'"),
        ("task: peg-insertion\nseed: 3\nseed: 4\n", "given twice"),
        ("- 1\n", "recipe.yaml"),
        ("task: lock-opening\nseed: 3\ngenerations: 2\n", r"is searched; run `vitac train search` with this recipe\.$"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(DocumentRejected, match=told):
        read(tmp_path, text)
