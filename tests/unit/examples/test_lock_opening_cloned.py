"""The cloned lock policy: its weights as shipped, how it looks ahead, and that its card tells what was measured."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from example_policies import load
from trained_policy import played, public_starts
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import load_track

TASK = "lock-opening"
KEYS = ("marker_flow", "relative_motion")


EXAMPLE = "lock_opening_cloned"


@pytest.fixture(scope="module")
def module(example: Path) -> Any:
    return load(example / "Track_1" / "policy.py")


def test_its_weights_are_small_and_finite_and_read_what_it_observes(example: Path) -> None:
    assert load_manifest(example / "Track_1").observation_keys == KEYS
    assert (example / "Track_1" / "weights.npz").stat().st_size < 250_000
    with np.load(example / "Track_1" / "weights.npz", allow_pickle=False) as stored:
        assert all(np.isfinite(stored[name]).all() for name in stored.files)


def test_what_was_felt_longer_ago_than_its_window_changes_nothing(module: Any) -> None:
    def acts(first: float) -> list[list[float]]:
        random, policy = np.random.default_rng(1), module.Policy()
        policy.reset(TASK)
        seen = random.normal(size=(module.WINDOW + module.CHUNK, 3))
        seen[0] = first
        flows = random.normal(size=(len(seen), 2, 2, 128, 2))
        return [
            policy.act({"marker_flow": flow, "relative_motion": motion}).tolist()
            for flow, motion in zip(flows, seen, strict=True)
        ]

    one, other = acts(0.0), acts(5.0)
    assert one[0] != other[0]
    assert one[-1] == other[-1]


def test_opens_most_of_some_locks(module: Any) -> None:
    env = make_environment(load_track("track_1").tasks[TASK], observation_keys=KEYS)
    ends = [played(env, module.Policy(), start, TASK)["end"] for start in list(public_starts(TASK))[3::13]]
    assert ends.count("success") >= 6
    assert set(ends) <= {"success", "tactile", "steps"}


def test_card_has_the_figures_of_the_table(example: Path, repository: Path) -> None:
    figures = (repository / "benchmarks" / "baselines.md").read_text().partition("## By shape")[0]
    (row,) = [row for row in figures.splitlines() if "lock_opening_cloned" in row]
    card = (example / "README.md").read_text()
    assert all(cell in card for cell in re.findall(r"[0-9.]+ \[[0-9., ]+\]", row))
