"""The table of baselines: written by a command, which counts what it says it counts."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from policies.baselines import (
    BASELINES,
    EXAMPLES,
    HEAD,
    SEEDS,
    SHAPES,
    Row,
    line,
    load_policy,
    percent,
    seed_lines,
    shapes_line,
    training_seeds,
)
from policies.marker_noise import errors
from toy_peg import ToyPeg
from trained_policy import figures, fresh_starts, played, public_starts
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.tracks import load_track
from vitac.training.collection import random_actor
from vitac.training.episodes import play
from vitac.training.streams import Use, stream


class Counting:
    """An environment whose episode ends after as many env steps as its start says, well if they are few."""

    def reset(self, *, options: Any) -> Any:
        self.left = self.wanted = 1 + options["rng_seed"][1] % 4
        self.task_scene = SimpleNamespace(shape="ab"[self.wanted % 2])
        return {}, {"end_reason": None}

    def step(self, action: np.ndarray) -> Any:
        self.left -= 1
        end = None if self.left else "success" if self.wanted < 3 else "tactile"
        return {}, 0.0, False, False, {"end_reason": end, "steps": self.wanted}


class Still:
    """Does nothing."""

    def reset(self, task: str) -> None:
        assert task == "peg-insertion"

    def act(self, observation: Any) -> np.ndarray:
        return np.zeros(3, dtype=np.float32)


def test_figures_count_successes_ends_and_shapes() -> None:
    found = figures(Counting(), Still(), fresh_starts(1, 8))
    assert (found["successes"], found["episodes"], found["mean_steps"]) == (4, 8, 1.5)
    assert found["ends"] == {"success": 4, "tactile": 4}
    assert {shape: rows["episodes"] for shape, rows in found["by_shape"].items()} == {"a": 4, "b": 4}
    assert played(Counting(), Still(), {"rng_seed": (0, 3)}) == {"shape": "a", "end": "tactile", "env_steps": 4}


def test_episodes_that_did_not_converge_are_listed() -> None:
    class Stuck(Counting):
        def step(self, action: np.ndarray) -> Any:
            observation, reward, terminated, truncated, info = super().step(action)
            end = {"tactile": "not_converged"}.get(info["end_reason"], info["end_reason"])
            return observation, reward, terminated, truncated, {**info, "end_reason": end}

    found = figures(Stuck(), Still(), fresh_starts(0, 4))
    assert found["not_converged"] == [{"rng_seed": (stream(0, Use.REPORT), number)} for number in (2, 3)]
    assert figures(Counting(), Still(), fresh_starts(0, 4))["not_converged"] == []


def test_policy_is_told_the_task_it_plays() -> None:
    class Told(Still):
        def reset(self, task: str) -> None:
            assert task == "lock-opening"

    assert figures(Counting(), Told(), fresh_starts(1, 2), "lock-opening")["episodes"] == 2


def test_fresh_starts_are_those_that_nothing_was_learned_from() -> None:
    assert [start["rng_seed"] for start in fresh_starts(2, 3)] == [
        (stream(2, Use.REPORT), number) for number in range(3)
    ]


@pytest.mark.parametrize(("task", "count"), [("peg-insertion", 270), ("lock-opening", 160)])
def test_public_starts_are_the_whole_list(task: str, count: int) -> None:
    starts = list(public_starts(task))
    assert len(starts) == count
    assert starts[0] == load_track("track_1").tasks[task].episodes[0].options


def test_every_baseline_is_an_example_of_a_task() -> None:
    for task, names in BASELINES.items():
        assert task in load_track("track_1").tasks
        assert all((EXAMPLES / name / "Track_1" / "policy.py").exists() for name in names)


def test_line_has_the_rates_with_intervals_and_the_cost() -> None:
    fresh = rate(150, 300).model_dump() | {"mean_steps": 4.25}
    public = rate(0, 100).model_dump() | {"mean_steps": 0.0}
    row = Row(task="peg-insertion", name="none", fresh=fresh, public=public, cpu_s=20.0)
    assert line(row) == f"| peg-insertion | none | {percent(fresh)} | 4.25 | {percent(public)} | - | 50 |\n"
    assert percent(fresh).startswith("50.0 [44.")
    by_shape = {
        "key1": rate(3, 4).model_dump() | {"solved_of_start": [0, 1, 1]},
        "key2": rate(0, 6).model_dump() | {"solved_of_start": [6, 0]},
    }
    shown = shapes_line(replace(row, public={**public, "by_shape": by_shape}))
    assert shown == "| peg-insertion | none | key1 3 of 4 (0 1 1), key2 0 of 6 (6 0) |\n"


def test_table_in_the_repository_has_every_baseline(repository: Path) -> None:
    written = (repository / "benchmarks" / "baselines.md").read_text()
    assert written.startswith(HEAD.format(stream=stream(1, Use.REPORT), starts=300))
    baselines, seeds = written.split(SEEDS)
    for part in baselines.split(SHAPES):
        rows = [row.split(" | ") for row in part.splitlines() if row.startswith(("| peg", "| lock"))]
        named = [(row[0].removeprefix("| "), row[1]) for row in rows]
        assert named == [(task, name) for task, names in BASELINES.items() for name in names]
    assert seeds == "".join(map(seed_lines, training_seeds()))


def test_three_seeds_of_each_trained_baseline_are_told_and_the_interval_of_their_mean_counts_seeds() -> None:
    runs = list(training_seeds())
    assert [run[:2] for run in runs] == [(task, names[0]) for task, names in BASELINES.items()]
    assert all(list(by_seed) == ["1", "2", "3"] for _, _, by_seed in runs)
    seeds = {
        seed: {
            "fresh": rate(solved, 40).model_dump() | {"mean_steps": 4.25},
            "public": rate(30, 40).model_dump() | {"mean_steps": 4.5},
        }
        for seed, solved in (("1", 12), ("2", 32))
    }
    first, _, mean = seed_lines(("peg-insertion", "trained", seeds)).splitlines()
    assert first == "| peg-insertion | trained | 1 | 30.0 | 4.25 | 75.0 | 30 of 40 | 4.50 |"
    assert mean == "| peg-insertion | trained | mean | 55.0 [0.0, 100.0] |  | 75.0 |  |  |"


def test_repeats_of_a_start_are_counted_together() -> None:
    task = load_track("track_1").tasks["peg-insertion"]
    found = figures(Counting(), Still(), iter([episode.options for episode in task.episodes]))
    assert 90 <= sum(sum(part["solved_of_start"]) for part in found["by_shape"].values()) < 270


def test_noise_takes_what_a_belief_is_further_from_the_truth_with_it() -> None:
    weights = load_policy(EXAMPLES / "peg_insertion_trained").weights
    played = [play(ToyPeg(), random_actor, 7, numbers) for numbers in (range(200), range(200, 280))]
    blurred = [
        replace(
            each, felt=each.felt + 3.0 * np.random.default_rng(1).standard_normal(each.felt.shape, dtype=np.float32)
        )
        for each in played
    ]
    exact, noisy = (errors(weights, *parts) for parts in (played, blurred))
    assert [row["env_steps"] for row in exact] == [row["env_steps"] for row in noisy] == [0, 1, 2, 3]
    assert exact[0]["looks"] == 80
    assert all(row["error"][0] < 0.75 * other["error"][0] for row, other in zip(exact, noisy, strict=True))
    assert exact[0]["spread"] == noisy[0]["spread"]
