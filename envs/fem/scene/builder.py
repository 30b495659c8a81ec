"""Builds the arrays of a scene's model from its bodies and settings."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..affine import frame_mass
from ..elastic.hexahedra import stabilisation_n_m
from ..elastic.neo_hookean import lame_parameters_pa
from ..elastic.viscosity import build_branches
from ..elastic.yeoh import yeoh_pa
from ..linear.ordering import Elimination
from ..linear.system import SystemLayout, gel_block_places, system_layout
from ..model.mesh import GelBody, GelMesh, RigidBody
from ..model.model import PRESCRIBED, Affine, Elastic, Hexahedra, Model, Parameters, Points, Surfaces, Unknowns
from ..model.settings import AnyContactSettings, SolverSettings
from .coupling import NO_COUPLINGS, join_eliminations
from .layout import NodeLayout

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Every episode builds its scene; what follows from the meshes of the gels alone is kept for this number of them.
_LAYOUTS_KEPT = 8


class GelLayout(NamedTuple):
    """What follows from the meshes of all gels and from which of their nodes contacts couple.

    Attributes:
        order: free nodes in order of elimination.
        tetrahedra: nodes of the gels that are meshed by them, shape [t, 4].
        places: see `Elastic`.
        reaction: see `Elastic`.
        hexahedra: nodes of the other gels, shape [c, 8].
        hexahedron_places: see `Hexahedra`.
        system: places of the Newton matrix, with the frame points of the movable bodies.
    """

    order: IndexArray
    tetrahedra: IndexArray
    places: IndexArray
    reaction: NDArray[np.bool_]
    hexahedra: IndexArray
    hexahedron_places: IndexArray
    system: SystemLayout


def build_model(
    layout: NodeLayout,
    time_step_s: float,
    contact: AnyContactSettings,
    solver: SolverSettings,
    couplings: IndexArray = NO_COUPLINGS,
) -> Model:
    """Return the model of the gels and bodies of a layout, stepped by time_step_s [s].

    The matrix has places for the `couplings` [k, 2] of nodes of gels that touch each other.
    """
    gels, bodies, constants = layout.gels, layout.bodies, contact.constants(time_step_s)
    movable = sum(not body.fixed for body in bodies)
    meshes = tuple(gel.mesh for gel in gels)
    of_gels = lay_out_gels(meshes, 4 * movable)
    if len(couplings):
        of_gels = _lay_out(meshes, join_eliminations(meshes, couplings, layout.initial_positions_m()), 4 * movable)
    unknowns = _build_unknowns(gels, bodies, layout, of_gels)
    return Model(
        elastic=_build_elastic(gels, of_gels),
        hexahedra=_build_hexahedra(gels, of_gels, time_step_s),
        affine=_build_affine(bodies, layout, unknowns, constants.affine_stiffness_pa),
        points=_build_points(gels, bodies, layout),
        surfaces=_build_surfaces(gels, bodies, contact, counts_once=constants.is_arena),
        unknowns=unknowns,
        system=of_gels.system,
        parameters=Parameters(
            time_step_s=time_step_s,
            d_hat_m=constants.d_hat_m,
            barrier_stiffness_n_m=constants.barrier_stiffness_n_m,
            counts_once=constants.is_arena,
            remembers_slip=constants.is_arena,
            slip_scale_m=constants.slip_scale_m,
            tangential_stiffness_n_m=constants.tangential_stiffness_n_m,
            ccd_gap_fraction=contact.ccd_gap_fraction,
            candidate_margin_m=solver.candidate_margin_m,
        ),
    )


@lru_cache(maxsize=_LAYOUTS_KEPT)
def lay_out_gels(meshes: tuple[GelMesh, ...], frame_points: int) -> GelLayout:
    """Return the layout of gels that touch no other, in order, and of this number of frame points; made once."""
    return _lay_out(meshes, join_eliminations(meshes, NO_COUPLINGS, np.empty((0, 3))), frame_points)


def _lay_out(meshes: tuple[GelMesh, ...], eliminations: list[Elimination], frame_points: int) -> GelLayout:
    starts = np.cumsum([0, *(len(mesh.rest_position_m) for mesh in meshes)])
    placed = list(zip(meshes, starts[:-1], strict=True))
    order = np.concatenate([part.nodes for part in eliminations])
    none = np.empty((0, 4), dtype=np.int64)
    tetrahedra = np.concatenate([none, *(mesh.tetrahedra + start for mesh, start in placed if not mesh.is_hexahedral)])
    hexahedra = np.concatenate([mesh.hexahedra + start for mesh, start in placed])
    slot = np.full(starts[-1], PRESCRIBED, dtype=np.int64)
    slot[order] = np.arange(len(order))
    first, second = _ordered_pairs(slot[tetrahedra])
    system = system_layout(eliminations, frame_points)
    return GelLayout(
        order=order,
        tetrahedra=tetrahedra,
        places=gel_block_places(system.neighbours, first, second),
        reaction=(first == PRESCRIBED) != (second == PRESCRIBED),
        hexahedra=hexahedra,
        hexahedron_places=gel_block_places(system.neighbours, *_ordered_pairs(slot[hexahedra])),
        system=system,
    )


def _ordered_pairs(elements: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the first and the second of all ordered pairs of numbers in elements [t, k], shapes [t, k^2]."""
    corners = elements.shape[1]
    return np.repeat(elements, corners, axis=1), np.tile(elements, corners)


def _build_elastic(gels: tuple[GelBody, ...], of_gels: GelLayout) -> Elastic:
    gradients, volumes, mu, lam = [np.empty((0, 4, 3))], [np.empty(0)], [np.empty(0)], [np.empty(0)]
    for gel in (gel for gel in gels if not gel.mesh.is_hexahedral):
        mu_pa, lambda_pa = lame_parameters_pa(gel.youngs_modulus_pa, gel.poisson_ratio)
        gradients.append(_rotated(gel.mesh.rest_gradients_1_m, gel.rotation))
        volumes.append(gel.mesh.volumes_m3)
        mu.append(np.full(len(gel.mesh.tetrahedra), mu_pa))
        lam.append(np.full(len(gel.mesh.tetrahedra), lambda_pa))
    return Elastic(
        nodes=of_gels.tetrahedra,
        gradients_1_m=np.concatenate(gradients),
        volume_m3=np.concatenate(volumes),
        mu_pa=np.concatenate(mu),
        lambda_pa=np.concatenate(lam),
        places=of_gels.places,
        reaction=of_gels.reaction,
    )


def _build_hexahedra(gels: tuple[GelBody, ...], of_gels: GelLayout, time_step_s: float) -> Hexahedra:
    blocks = [gel.mesh.blocks for gel in gels]
    counts = [len(gel.mesh.hexahedra) for gel in gels]
    lame_pa = np.array([lame_parameters_pa(gel.youngs_modulus_pa, gel.poisson_ratio) for gel in gels])
    stiffening = np.concatenate(
        [np.ones(count) if gel.stiffening is None else gel.stiffening for gel, count in zip(gels, counts, strict=True)]
    )
    mu_pa, lambda_pa = stiffening * np.repeat(lame_pa, counts, axis=0).T
    stabilisation = [
        stabilisation_n_m(block.volume_m3, block.size_m, gel.youngs_modulus_pa, gel.poisson_ratio)
        for block, gel in zip(blocks, gels, strict=True)
    ]
    return Hexahedra(
        nodes=of_gels.hexahedra,
        weights=np.concatenate([block.weights for block in blocks]).ravel(),
        volume_m3=np.concatenate([block.volume_m3 for block in blocks]),
        mu_pa=np.ascontiguousarray(mu_pa),
        lambda_pa=np.ascontiguousarray(lambda_pa),
        stabilisation_n_m=stiffening[:, None] * np.concatenate(stabilisation),
        viscous_pa=build_branches(gels, time_step_s).modulus_pa.sum(axis=0),
        yeoh_pa=yeoh_pa(gels),
        places=of_gels.hexahedron_places,
    )


def _rotated(vectors: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the vectors of shape [t, 4, 3] turned by a rotation, without BLAS."""
    return np.asarray((rotation[None, None, :, :] * vectors[:, :, None, :]).sum(axis=3))


def _build_affine(
    bodies: tuple[RigidBody, ...],
    layout: NodeLayout,
    unknowns: Unknowns,
    stiffness_pa: float,
) -> Affine:
    movable = [i for i, body in enumerate(bodies) if not body.fixed]
    masses = [_mass_kg(bodies[i], i, layout) for i in movable]
    first_node = np.array([layout.body_slices[i].start for i in movable], dtype=np.int64)
    return Affine(
        first_node=first_node,
        first_unknown=unknowns.slot[first_node],
        frame_length_m=np.array([layout.body_lengths_m[i] for i in movable]),
        mass_kg=np.stack(masses) if masses else np.empty((0, 4, 4)),
        stiffness_j=np.array([stiffness_pa * bodies[i].mesh.volume_m3 for i in movable]),
    )


def _mass_kg(body: RigidBody, index: int, layout: NodeLayout) -> FloatArray:
    """Return the mass matrix of a body [kg], shape [4, 4], per coordinate: of its solid and its point masses."""
    mass = frame_mass(body.mesh, layout.body_centroids_m[index], layout.body_lengths_m[index], body.density_kg_m3)
    for mass_kg, point_m in body.point_masses:
        weights = layout.point_weights(index, point_m)
        mass += mass_kg * weights[:, None] * weights[None, :]
    return mass


def _build_points(gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...], layout: NodeLayout) -> Points:
    nodes, weights, counts = [], [], []
    for gel, rows in zip(gels, layout.gel_slices, strict=True):
        surface = gel.mesh.surface_nodes + rows.start
        nodes.append(np.repeat(surface[:, None], 4, axis=1))
        weights.append(np.tile([1.0, 0.0, 0.0, 0.0], (len(surface), 1)))
        counts.append(np.ones(len(surface), dtype=np.int64))
    for body, rows, body_weights in zip(bodies, layout.body_slices, layout.body_weights, strict=True):
        vertices = len(body.mesh.vertices_m)
        nodes.append(np.tile(np.arange(rows.start, rows.start + 4), (vertices, 1)))
        weights.append(body_weights)
        counts.append(np.full(vertices, 4, dtype=np.int64))
    return Points(np.concatenate(nodes), np.concatenate(weights), np.concatenate(counts))


def _build_surfaces(
    gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...], contact: AnyContactSettings, *, counts_once: bool
) -> Surfaces:
    point_start, edge_start, triangle_start, vertex_start = [0], [0], [0], [0]
    edges, lengths, triangles, vertices, neighbours = [], [], [], [], []
    members = [(*gel.mesh.surface, gel.mesh.surface_neighbours, gel.mesh.surface_edges) for gel in gels]
    for mesh in (body.mesh for body in bodies):
        touching = mesh.convex_edges if counts_once else mesh.edges
        members.append((mesh.vertices_m, mesh.triangles, mesh.neighbours, touching))
    for rest, body_triangles, body_neighbours, body_edges in members:
        vectors = rest[body_edges[:, 1]] - rest[body_edges[:, 0]]
        ends = np.unique(body_edges) if counts_once else np.arange(len(rest))
        edges.append(body_edges + point_start[-1])
        lengths.append((vectors**2).sum(axis=1))
        triangles.append(body_triangles + point_start[-1])
        vertices.append(ends + point_start[-1])
        neighbours.append(body_neighbours + triangle_start[-1])
        point_start.append(point_start[-1] + len(rest))
        edge_start.append(edge_start[-1] + len(body_edges))
        triangle_start.append(triangle_start[-1] + len(body_triangles))
        vertex_start.append(vertex_start[-1] + len(ends))
    corners = np.concatenate(triangles)
    pairs, friction = _touching_pairs(gels, bodies, contact)
    return Surfaces(
        point_start=np.array(point_start, dtype=np.int64),
        edges=np.concatenate(edges),
        edge_start=np.array(edge_start, dtype=np.int64),
        edge_squared_length_m2=np.concatenate(lengths),
        triangles=corners,
        triangle_start=np.array(triangle_start, dtype=np.int64),
        vertices=np.concatenate(vertices),
        vertex_start=np.array(vertex_start, dtype=np.int64),
        neighbours=np.concatenate(neighbours),
        around=np.argsort(corners.ravel(), kind="stable") // 3,
        around_start=np.searchsorted(np.sort(corners.ravel()), np.arange(point_start[-1] + 1)),
        point_body=np.repeat(np.arange(len(members)), np.diff(point_start)),
        pairs=pairs,
        pair_friction=friction,
    )


def _touching_pairs(
    gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...], contact: AnyContactSettings
) -> tuple[IndexArray, FloatArray]:
    """Return pairs of different bodies of which one at least can move, and their friction coefficients."""
    members: list[GelBody | RigidBody] = [*gels, *bodies]
    pairs, friction = [], []
    for a, first in enumerate(members):
        for b in range(a + 1, len(members)):
            second = members[b]
            if isinstance(first, RigidBody) and first.fixed and isinstance(second, RigidBody) and second.fixed:
                continue
            pairs.append((a, b))
            friction.append(contact.pair_friction(first, second))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(friction)


def _build_unknowns(
    gels: tuple[GelBody, ...], bodies: tuple[RigidBody, ...], layout: NodeLayout, of_gels: GelLayout
) -> Unknowns:
    total = layout.body_slices[-1].stop if bodies else layout.gel_slices[-1].stop
    slot = np.full(total, PRESCRIBED, dtype=np.int64)
    mass = np.zeros(total)
    for gel, rows in zip(gels, layout.gel_slices, strict=True):
        mass[rows] = gel.mesh.node_masses_kg(gel.density_kg_m3)
    frames = [
        np.arange(rows.start, rows.stop)
        for body, rows in zip(bodies, layout.body_slices, strict=True)
        if not body.fixed
    ]
    order = np.concatenate([of_gels.order, *frames])
    slot[order] = np.arange(len(order))
    return Unknowns(slot=slot, node=order, node_mass_kg=mass)
