"""Which nodes of different gels touch each other, and how gels that do are eliminated together."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..contact.broad_phase import find_candidates
from ..linear.ordering import Elimination, plan_elimination
from ..model.mesh import GelMesh
from ..model.model import PRESCRIBED, Model, point_positions

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Surfaces this near are planned for [m], about half a cell of a gel: sliding by less needs no other plan.
PLANNED_WITHIN_M = 1e-3
NO_COUPLINGS: IndexArray = np.empty((0, 2), dtype=np.int64)


def boxes_come_near(gels_m: Sequence[FloatArray], within_m: float) -> bool:
    """Return whether the boxes around two of the gels, nodes [m] of shape [n, 3] each, are this near [m]."""
    boxes = [(nodes_m.min(axis=0), nodes_m.max(axis=0) + within_m) for nodes_m in gels_m]
    return any(
        (low <= other_high).all() and (other_low <= high).all()
        for (low, high), (other_low, other_high) in combinations(boxes, 2)
    )


def near_nodes(model: Model, gels: int, x: FloatArray, within_m: float) -> IndexArray:
    """Return the free nodes of different gels that a contact can couple at nodes x [m] of shape [n, 3].

    The smaller of two comes first, pairs ascend, shape [k, 2].

    Args:
        model: of the scene, whose first bodies are the gels.
        gels: their number.
        x: node positions [m], shape [n, 3].
        within_m: how far apart surfaces may be [m].
    """
    of_gels = (model.surfaces.pairs < gels).all(axis=1)
    surfaces = model.surfaces._replace(
        pairs=model.surfaces.pairs[of_gels], pair_friction=model.surfaces.pair_friction[of_gels]
    )
    y = np.empty((len(model.points.node_count), 3))
    point_positions(model.points, x, y)
    found = find_candidates(surfaces, y, np.full(len(surfaces.pairs), within_m))
    nodes = model.points.nodes[found.points, 0]
    of_body = surfaces.point_body[found.points]
    pairs = [np.sort(nodes[:, [i, j]][of_body[:, i] != of_body[:, j]], axis=1) for i, j in combinations(range(4), 2)]
    coupled = np.unique(np.concatenate([NO_COUPLINGS, *pairs]), axis=0)
    return np.asarray(coupled[(model.unknowns.slot[coupled] != PRESCRIBED).all(axis=1)])


def includes(couplings: IndexArray, others: IndexArray) -> bool:
    """Return whether all pairs of `others` [k, 2] are among the couplings [n, 2]."""
    known = set(map(tuple, couplings.tolist()))
    return all(tuple(pair) in known for pair in others.tolist())


def join_eliminations(meshes: Sequence[GelMesh], couplings: IndexArray, positions_m: FloatArray) -> list[Elimination]:
    """Return one elimination for all gels that are coupled to each other, in the numbers of the scene's nodes.

    That of a gel which touches no other is its mesh's.

    Args:
        meshes: of the gels, numbered one after the other.
        couplings: nodes of different gels that contacts couple, shape [k, 2].
        positions_m: of all nodes as the gels were placed, by which joined ones are cut in parts [m], shape [n, 3].
    """
    starts = np.cumsum([0, *(len(mesh.rest_position_m) for mesh in meshes)])
    group = np.arange(len(meshes))
    for first, second in np.unique(np.searchsorted(starts, couplings, side="right") - 1, axis=0):
        group[group == group[second]] = group[first]
    own = [
        mesh.elimination._replace(nodes=mesh.elimination.nodes + start)
        for mesh, start in zip(meshes, starts, strict=False)
    ]
    joined = []
    for name in dict.fromkeys(group.tolist()):
        members = np.flatnonzero(group == name)
        of_group = [own[member] for member in members]
        if len(members) > 1:
            among = np.isin(np.searchsorted(starts, couplings[:, 0], side="right") - 1, members)
            of_group = [_join(of_group, couplings[among], positions_m)]
        joined += of_group
    return joined


def _join(parts: Sequence[Elimination], couplings: IndexArray, positions_m: FloatArray) -> Elimination:
    nodes = np.sort(np.concatenate([part.nodes for part in parts]))
    edges = np.concatenate([*(part.nodes[part.edges] for part in parts), couplings])
    return plan_elimination(nodes, np.searchsorted(nodes, edges), positions_m[nodes])
