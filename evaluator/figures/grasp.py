"""How a gel holds a peg that touches nothing else, and how much its tetrahedra are compressed."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from .figures import GraspFigures, rounded

if TYPE_CHECKING:
    from vitac.envs.scene.grasped_scene import GraspedScene

START: Final = {"shape": "cuboid", "offset_mm_deg": (0.0, 0.0, 0.0), "rng_seed": (0, 0)}
"""In its hole the peg hangs freely."""


def grasp_figures(env: Any) -> GraspFigures:
    """Return indentation and force of the grasp, which are the same at every start.

    Args:
        env: of the peg task, with the sensor; it is reset here.
    """
    env.reset(options=START)
    scene: GraspedScene = env.scene
    return GraspFigures(
        indentation_mm=rounded(max(_indentation_mm(scene, index) for index in range(2))),
        force_n=rounded(0.5 * sum(_force_n(scene, index) for index in range(2))),
        smallest_det_f=rounded(smallest_det_f(scene)),
    )


def smallest_det_f(scene: "GraspedScene") -> float:
    """Return the smallest det F, the ratio of a tetrahedron's volume to that at rest, of both gels."""
    from vitac.envs.fem.model.mesh import signed_volumes_m3

    gel = scene.gel
    return min(
        float((signed_volumes_m3(scene.gel_nodes_m(index)[gel.tetrahedra]) / gel.volumes_m3).min())
        for index in range(2)
    )


def _indentation_mm(scene: "GraspedScene", index: int) -> float:
    """Return how far the sensing face is pressed in where it is pressed in most [mm]."""
    gel, pose = scene.gel, scene.sensor_pose(index)
    moved = (scene.gel_nodes_m(index) - pose.centre_m)[gel.sensing_nodes]
    heights_m = (moved * pose.rotation[:, 2]).sum(axis=1)
    return 1e3 * float((gel.rest_position_m[gel.sensing_nodes, 2] - heights_m).max())


def _force_n(scene: "GraspedScene", index: int) -> float:
    """Return the force with which a finger presses its gel towards the peg [N].

    In equilibrium it is what the tetrahedra's stress puts on the driven nodes: the sum of V sigma grad N_a, with volume
    V and gradients in the deformed gel (J. Bonet and R. D. Wood, Nonlinear Continuum Mechanics (2008), equation 9.15).
    """
    from vitac.envs.drawing.stress import cauchy_stress_pa, deformation_gradients

    gel, physics, pose = scene.gel, scene.physics, scene.sensor_pose(index)
    nodes_m = scene.gel_nodes_m(index)
    stress_pa = cauchy_stress_pa(
        deformation_gradients(gel.rest_position_m, nodes_m, gel.tetrahedra),
        youngs_modulus_pa=physics.youngs_modulus_pa,
        poisson_ratio=physics.poisson_ratio,
    )
    corners = nodes_m[gel.tetrahedra]
    e1, e2, e3 = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    # 6 V grad N_a of corners 1 to 3; those of all four sum to zero.
    inner = np.stack([np.cross(e2, e3), np.cross(e3, e1), np.cross(e1, e2)], axis=1)
    gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1) / 6.0
    forces_n = np.einsum("tij,taj->tai", stress_pa, gradients)
    total = forces_n[gel.driven[gel.tetrahedra]].sum(axis=0)
    return float((total * pose.rotation[:, 2]).sum())
