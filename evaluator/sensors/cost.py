"""What a gel's mesh costs in an evaluation; shown before one is started."""

import math

# Measured with our mesher's gels of 162 to 584 nodes on one core of an x86-64 with AVX-512, which other work kept busy.
_IPC_STEPS = 36
_REFERENCE_NODES = 280
_REFERENCE_S = 2.5e-3
_GROWTH = 1.4


def expected_cpu_s(nodes: int, *, episodes: int) -> float:
    """Return about how much CPU time episodes of the peg task take [s], within a third on a machine like ours.

    An IPC step's time grows with the nodes' number to the power of 1.4, and an episode has about 36 of them.

    Args:
        nodes: of the gel's mesh.
        episodes: how many are played.
    """
    return episodes * _IPC_STEPS * _REFERENCE_S * math.pow(nodes / _REFERENCE_NODES, _GROWTH)
