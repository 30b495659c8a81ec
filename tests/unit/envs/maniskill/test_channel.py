"""Everything that an environment of ManiSkill shows can be sent to a policy."""

import numpy as np
from vitac.envs.maniskill.definition import MODES, catalogue, find_definition
from vitac.evaluator.agent.protocol import array_code

LARGEST_MB = 2.2
"""As much as an env step of our own task with cameras sends."""


def test_every_observation_is_of_types_and_a_size_that_the_channel_carries() -> None:
    for name, described in catalogue().environments.items():
        control_mode = next(iter(described.control_modes))
        for mode in MODES:
            rows = find_definition(f"ManiSkill/{name}", {"obs_mode": mode, "control_mode": control_mode}).observables
            arrays = [np.zeros(row.shape, row.dtype) for row in rows]
            assert all(array_code(value) for value in arrays)
            assert sum(value.nbytes for value in arrays) < LARGEST_MB * 1e6, (name, mode)
