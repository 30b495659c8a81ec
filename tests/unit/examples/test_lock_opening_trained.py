"""The searched lock policy: it is what its recipe and search make, and its card tells what was measured."""

import json
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from toy_lock import turned_flow
from trained_policy import played, public_starts
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import interval_of_seeds, rate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import load_track
from vitac.training.export import LARGEST_BYTES
from vitac.training.search.method import read_search_recipe
from vitac.training.search.policy import ACTIONS, FEATURES
from vitac.training.streams import Use, stream

TASK = "lock-opening"
EXAMPLE = "lock_opening_trained"


@pytest.fixture(scope="module")
def policy(example: Path) -> Any:
    return run_path(str(example / "Track_1" / "policy.py"))["Policy"]()


def test_is_a_valid_submission_with_the_policy_of_the_search(example: Path, repository: Path) -> None:
    manifest = load_manifest(example / "Track_1")
    assert (manifest.tasks, manifest.entry_point) == ((TASK,), "policy:Policy")
    assert manifest.observation_keys == ("marker_flow",)
    searched = repository / "training" / "search" / "policy.py"
    assert (example / "Track_1" / "policy.py").read_bytes() == searched.read_bytes()


def test_weights_are_sixteen_numbers_without_pickle(example: Path, policy: Any) -> None:
    assert policy.weights.shape == (ACTIONS, FEATURES)
    assert np.isfinite(policy.weights).all()
    assert (example / "Track_1" / "weights.npz").stat().st_size < LARGEST_BYTES


def test_lifts_in_every_env_step_and_pulls_less_once_the_teeth_are_free(policy: Any) -> None:
    def pull_after_two(turn_rad: float) -> float:
        policy.reset(TASK)
        actions = [policy.act({"marker_flow": turned_flow(turn)}) for turn in (0.0, turn_rad, turn_rad)]
        assert max(action[1] for action in actions) < -0.5
        return -float(actions[-1][0])

    assert pull_after_two(0.014) > pull_after_two(0.0)


def test_opens_a_lock_of_every_key_in_few_env_steps(policy: Any) -> None:
    starts = list(public_starts(TASK))[5::40]
    assert sorted({start["shape"] for start in starts}) == ["key1", "key2", "key3", "key4"]
    env = make_environment(load_track("track_1").tasks[TASK])
    ends = [played(env, policy, start, TASK) for start in starts]
    assert [end["end"] for end in ends] == ["success"] * 4
    assert max(end["env_steps"] for end in ends) <= 6


def test_logs_are_those_of_the_recipe_and_say_which_generation_was_chosen(
    example: Path, figures: dict[str, Any]
) -> None:
    recipe = read_search_recipe(example / "recipe.yaml")
    for seed, found in {str(recipe.seed): figures, **figures["seeds"]}.items():
        log = example / ("log.jsonl" if found is figures else f"log_seed_{seed}.jsonl")
        rows = [json.loads(line) for line in log.read_text().splitlines()]
        assert [row["generation"] for row in rows] == list(range(1, recipe.generations + 1))
        assert {row["solved"]["episodes"] for row in rows} == {recipe.chosen_by}
        chosen = max(rows, key=lambda row: (row["solved"]["successes"], -row["mean_env_steps"], row["generation"]))
        assert found["generation"] == chosen["generation"]
        assert found["fresh"]["starts"] == f"stream {stream(int(seed), Use.REPORT)}"


def test_opens_enough_in_four_fifths_of_the_heuristics_env_steps(figures: dict[str, Any]) -> None:
    assert figures["public"]["successes"] >= 155
    assert figures["public"]["episodes"] == 160
    assert figures["fresh"]["episodes"] >= 270
    assert figures["fresh"]["success_rate"] >= 0.95
    for starts in ("fresh", "public"):
        assert figures[starts]["mean_steps"] <= 0.8 * figures["heuristic"][starts]["mean_steps"]


def said(card: str) -> str:
    return " ".join(card.split()).lower()


def seed_row(seed: str, found: dict[str, Any]) -> str:
    fresh, public = found["fresh"], found["public"]
    low, high = 100 * fresh["interval"]["low"], 100 * fresh["interval"]["high"]
    percent = f"{100 * fresh['success_rate']:.1f} [{low:.1f}, {high:.1f}]"
    return f"| {seed} | {percent} | {fresh['mean_steps']:.2f} | {public['successes']} | {public['mean_steps']:.2f} |"


def mean_row(runs: list[dict[str, Any]]) -> str:
    rates = [rate(found["fresh"]["successes"], found["fresh"]["episodes"]) for found in runs]
    interval, mean = interval_of_seeds(rates), np.mean([each.success_rate for each in rates])
    percent = f"{100 * mean:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
    name = "mean, [by seeds](../../docs/statistics.md)"
    env_steps = {starts: np.mean([found[starts]["mean_steps"] for found in runs]) for starts in ("fresh", "public")}
    solved = np.mean([found["public"]["successes"] for found in runs])
    return f"| {name} | {percent} | {env_steps['fresh']:.2f} | {solved:.1f} | {env_steps['public']:.2f} |"


def test_three_seeds_open_enough_and_as_fast_on_average(example: Path, figures: dict[str, Any]) -> None:
    card = (example / "README.md").read_text()
    assert sorted(figures["seeds"]) == ["2", "3"]
    runs = {"1": figures, **figures["seeds"]}
    rows = [*(seed_row(seed, found) for seed, found in runs.items()), mean_row(list(runs.values()))]
    assert "\n".join(["|---|---|---|---|---|", *rows, ""]) in card
    third, heuristic = (found["public"]["mean_steps"] for found in (runs["3"], figures["heuristic"]))
    assert f"there the third one takes {100 * third / heuristic:.0f} % of the heuristic's env steps" in said(card)
    for seed, found in figures["seeds"].items():
        assert found["fresh"]["starts"] == f"stream {stream(int(seed), Use.REPORT)}"
        assert found["fresh"]["success_rate"] >= 0.95
        assert found["public"]["successes"] >= 155
    for starts in ("fresh", "public"):
        env_steps = [found[starts]["mean_steps"] for found in runs.values()]
        assert np.mean(env_steps) <= 0.8 * figures["heuristic"][starts]["mean_steps"]


def test_card_tells_the_measured_figures(example: Path, figures: dict[str, Any]) -> None:
    card = (example / "README.md").read_text()
    for found in (figures["public"], figures["fresh"]):
        low, high = 100 * found["interval"]["low"], 100 * found["interval"]["high"]
        rate = f"{100 * found['success_rate']:.1f} % [{low:.1f}, {high:.1f}]"
        assert f"{found['successes']} of {found['episodes']} ({rate})" in card
        assert f"{found['mean_steps']:.2f}" in card
        assert sum(shape["episodes"] for shape in found["by_shape"].values()) == found["episodes"]
