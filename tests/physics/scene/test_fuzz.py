"""Random episodes at the bounds; FUZZ_EPISODES asks for more of them (500 for a release)."""

import os

import pytest

pytest.importorskip("ipctk", reason="the IPC Toolkit, which looks for intersections, has no wheel for this machine")

from balance_check import SAME_FORCE_N
from physics_fuzz import LOCK, PEG, fuzz_episode, summary

EPISODES = int(os.environ.get("FUZZ_EPISODES", "4"))


@pytest.mark.slow
@pytest.mark.parametrize("task", [PEG, LOCK])
def test_no_random_episode_makes_bodies_intersect_or_invert_or_overlooks_a_contact_or_stops_unsolved(task: str) -> None:
    steps = [step for seed in range(EPISODES) for step in fuzz_episode(task, seed)]
    found = summary(steps)
    assert found["intersections"] == 0
    assert found["overlooked"] == 0
    assert found["smallest_det_f"] > 0
    assert found["smallest_gap_m"] > 0
    assert found["looked_at"] > 0.5 * found["ipc_steps"]
    assert found["largest_force_left_n"] <= 1e-4 + SAME_FORCE_N
    assert found["misreported"] == 0
    assert found["unstable"] == 0
    assert found["not_converged"] <= 0.001 * found["ipc_steps"]


@pytest.mark.parametrize("seed", [20225, 20282])
def test_what_could_tip_over_to_either_side_tips_over(seed: int) -> None:
    """In these two episodes Newton's method arrives at balances with an unstable direction, however it goes there."""
    found = summary(list(fuzz_episode(PEG, seed)))
    assert found["escaped_saddle"] == 1
    assert (found["not_converged"], found["unstable"], found["intersections"]) == (0, 0, 0)
