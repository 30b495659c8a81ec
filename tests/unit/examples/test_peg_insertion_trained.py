"""The trained peg policy: it is what its recipe and training make, and its card tells what was measured."""

import json
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from example_policies import flow
from vitac.evaluator.submission.manifest import load_manifest
from vitac.training.export import LARGEST_BYTES
from vitac.training.recipe import read_recipe
from vitac.training.streams import Use, stream
from vitac.training.submission.policy import HISTORY_SIZE

EXAMPLE = "peg_insertion_trained"


@pytest.fixture(scope="module")
def policy(example: Path) -> Any:
    return run_path(str(example / "Track_1" / "policy.py"))["Policy"]()


def test_is_a_valid_submission_with_the_policy_of_the_training(example: Path, repository: Path) -> None:
    manifest = load_manifest(example / "Track_1")
    assert (manifest.tasks, manifest.entry_point) == (("peg-insertion",), "policy:Policy")
    assert manifest.observation_keys == ("marker_flow", "relative_motion")
    trained = repository / "training" / "submission" / "policy.py"
    assert (example / "Track_1" / "policy.py").read_bytes() == trained.read_bytes()


def test_weights_are_small_and_without_pickle(example: Path, policy: Any) -> None:
    assert (example / "Track_1" / "weights.npz").stat().st_size < LARGEST_BYTES
    assert policy.weights["0_history"].shape[0] == HISTORY_SIZE
    assert all(np.isfinite(value).all() for value in policy.weights.values())


@pytest.mark.parametrize("seed", range(3))
def test_actions_are_finite_and_within_bounds(policy: Any, seed: int) -> None:
    policy.reset("peg-insertion")
    motion = np.zeros(4, np.float32)
    for _ in range(3):
        seen = np.stack([flow(np.array([[2.9, 0], [0, 0], [0, 0]]), 0.5, seed + side) for side in (0, 1)])
        action = policy.act({"marker_flow": seen, "relative_motion": motion})
        assert (action.dtype, action.shape) == (np.float32, (3,))
        assert np.abs(action).max() <= 1
        assert np.abs(policy.belief() / [20.0, 20.0, 60.0]).max() < 1.0
        motion = motion + np.array([*(2 * action[:2]), 4 * action[2], -0.125], np.float32)


def test_log_is_that_of_its_recipe(example: Path, figures: dict[str, Any]) -> None:
    recipe = read_recipe(example / "recipe.yaml")
    for seed, found in {str(recipe.seed): figures, **figures["seeds"]}.items():
        log = example / ("log.jsonl" if found is figures else f"log_seed_{seed}.jsonl")
        rows = [json.loads(line) for line in log.read_text().splitlines()]
        assert [row["round"] for row in rows] == list(range(1, recipe.rounds + 1))
        assert found["fresh"]["starts"] == f"stream {stream(int(seed), Use.REPORT)}"
        assert found["round"] == max(rows, key=lambda row: (row["student"]["successes"], row["round"]))["round"]


def test_episodes_converge(figures: dict[str, Any]) -> None:
    runs = [figures, *figures["seeds"].values()]
    played = [found[part] for found in runs for part in ("public", "fresh", "more_fresh") if part in found]
    assert sum(found["episodes"] for found in played) == 3210
    assert sum(found["ends"].get("not_converged", 0) for found in played) == 0


def test_three_seeds_solve_enough_of_every_shape_and_with_the_truth_nearly_all(
    example: Path, figures: dict[str, Any]
) -> None:
    runs = {"1": figures, **figures["seeds"]}
    assert sorted(runs) == ["1", "2", "3"]
    assert np.mean([found["public"]["successes"] for found in runs.values()]) >= 180
    assert figures["public"]["successes"] >= 195
    assert figures["fresh"]["success_rate"] >= 0.68
    card = (example / "README.md").read_text()
    for seed, found in runs.items():
        assert found["public_with_truth"]["successes"] >= 265
        shapes = [found[part]["by_shape"].values() for part in ("public", "fresh")]
        lowest = min(shape["success_rate"] for part in shapes for shape in part)
        assert lowest >= 0.55
        solved, fresh = found["public"], percent(found["fresh"]).replace(" %", "")
        truth = found["public_with_truth"]["successes"]
        told = (
            f"| {seed} | {fresh} | {solved['successes']} | {solved['mean_steps']:.2f} | {100 * lowest:.1f} | {truth} |"
        )
        assert told in card, told


def test_card_tells_what_the_noise_takes(example: Path, figures: dict[str, Any]) -> None:
    noisy, exact = (figures["marker_noise"][noise] for noise in ("0.5 px", "0 px"))
    same = ("successes", "by_shape", "ends", "mean_steps")
    assert [noisy["solved"][key] for key in same] == [figures["fresh"][key] for key in same]
    card = (example / "README.md").read_text()
    solved = [found["solved"] for found in (noisy, exact)]
    assert all(f"{found['successes']} of 300 ({percent(found)})" in card for found in solved)
    for blurred, clear in zip(noisy["beliefs"][:4], exact["beliefs"][:4], strict=True):
        cells = [", ".join(f"{value:.2f}" for value in each) for each in (blurred["error"], clear["error"])]
        assert f"| {blurred['env_steps']} | {cells[0]} | {cells[1]} |" in card


def percent(found: dict[str, Any]) -> str:
    low, high = 100 * found["interval"]["low"], 100 * found["interval"]["high"]
    return f"{100 * found['success_rate']:.1f} % [{low:.1f}, {high:.1f}]"


def test_card_tells_the_measured_figures(example: Path, figures: dict[str, Any]) -> None:
    card = (example / "README.md").read_text()
    for part in ("public", "fresh", "more_fresh", "public_with_truth"):
        found = figures[part]
        told = f"{found['successes']} of {found['episodes']} ({percent(found)})"
        assert told in card, told
        assert sum(shape["episodes"] for shape in found["by_shape"].values()) == found["episodes"]
