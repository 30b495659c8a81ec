"""The engine against a second, slow solver of the same equations, over whole grasps and pushes."""

import numpy as np
import pytest
from recorded_pegs import OffsetMmDeg, RecordedPeg
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.geometry.pegs import PegShape

pytest.importorskip("ipctk", reason="the IPC Toolkit, which the oracle is made of, has no wheel for this machine")

from slow_oracle import FIXED, HELD, LEFT_GEL, RIGHT_GEL, SlowOracle

pytestmark = pytest.mark.slow

# Ten times the last move at which the engine stops.
AGREEMENT_M = 1e-7


@pytest.mark.parametrize(
    ("shape", "offset", "goal"),
    [
        (PegShape.CUBOID, (-4.0, -4.0, -8.0), (-3.9, -2.2, -7.88)),
        (PegShape.CONCAVE1, (2.0, -1.0, 4.0), (0.4, -0.2, 1.2)),
    ],
)
def test_every_state_of_a_grasp_and_a_push_is_the_one_that_the_oracle_finds(
    shape: PegShape, offset: OffsetMmDeg, goal: OffsetMmDeg
) -> None:
    """Both start from the undeformed scene and go on from their own states; the peg is pushed against the rim."""
    peg = RecordedPeg(shape, offset)
    oracle = SlowOracle(peg.grasped)
    peg.grasp()
    peg.travel(goal)
    assert all(report.status is StepStatus.CONVERGED for report in peg.reports)
    assert len(peg.states) >= 8
    for state in peg.states:
        oracle.step(state.gels_m[:, peg.grasped.gel.driven_nodes])
        for index in (LEFT_GEL, RIGHT_GEL):
            np.testing.assert_allclose(oracle.gel_nodes_m(index), state.gels_m[index], rtol=0, atol=AGREEMENT_M)
        np.testing.assert_allclose(oracle.held_vertices_m(), state.held_m, rtol=0, atol=AGREEMENT_M)
    assert oracle.touching(LEFT_GEL, HELD) > 10
    assert oracle.touching(RIGHT_GEL, HELD) > 10
    assert oracle.touching(HELD, FIXED) > 0
