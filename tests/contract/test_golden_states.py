"""The same actions give the states they gave before, to the last bit, wherever and whenever they are played.

A difference means that recorded results can no longer be reproduced: either the change is unwanted, or the solver
version goes up and `tests/support/envs/pinned_states.py` pins the new states.
"""

import json

import pytest
from pinned_states import EPISODES, PINNED, state_hashes
from vitac.envs.fem import SOLVER_VERSION

GOLDEN = json.loads(PINNED.read_text())


def test_states_are_pinned_for_this_solver() -> None:
    assert GOLDEN["solver_version"] == SOLVER_VERSION
    assert set(GOLDEN["state_hashes"]) == set(EPISODES)


@pytest.mark.parametrize("name", EPISODES)
def test_episode_gives_the_pinned_states(name: str) -> None:
    assert state_hashes(EPISODES[name]) == GOLDEN["state_hashes"][name]
