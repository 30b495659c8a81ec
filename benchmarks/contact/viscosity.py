"""Blocks of a viscous gel in simple shear, against the standard linear solid."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from block_meshes import hexahedral_box
from numpy.typing import NDArray
from small_scenes import IDENTITY
from vitac.envs.fem.elastic.neo_hookean import lame_parameters_pa
from vitac.envs.fem.model.mesh import GelBody, PronyBranch
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.tasks.settings import require

FloatArray = NDArray[np.float64]

# Shear strain, which makes the block as linear as theory.
_STRAIN = 1e-3


class ShearedBlock:
    """A drawn block of gel, of which all of the surface is driven: its shear stress follows from its strain."""

    def __init__(self, rng: np.random.Generator, poisson_ratio: float, steps_per_time: float) -> None:
        size = rng.uniform(2e-3, 6e-3, 3)
        box = hexahedral_box(tuple(size.tolist()), (2, 2, 2))
        rest = box.rest_position_m
        outside = np.any(np.abs(rest - 0.5 * size) >= 0.49 * size, axis=1)
        modulus_pa = float(rng.uniform(5e4, 1e6))
        self.branch = PronyBranch(
            modulus_ratio=float(rng.uniform(0.2, 1.5)), relaxation_time_s=float(rng.uniform(0.1, 20.0))
        )
        self.mu_pa, _ = lame_parameters_pa(modulus_pa, poisson_ratio)
        self.step_s = self.branch.relaxation_time_s / steps_per_time
        self._mesh, self._area_m2, self._height_m = replace(box, driven=outside), size[0] * size[1], size[2]
        gel = GelBody(
            mesh=self._mesh, rotation=IDENTITY, translation_m=np.zeros(3), youngs_modulus_pa=modulus_pa,
            poisson_ratio=poisson_ratio, viscosity=(self.branch,), density_kg_m3=1e-3,
        )  # fmt: skip
        self.scene = Scene(gels=[gel], bodies=[], time_step_s=self.step_s)

    def shear(self, strain: float) -> float:
        """Shear to a strain in one IPC step; return the stress [Pa] on the upper face, across its height."""
        rest = self._mesh.rest_position_m
        moved = rest + np.outer(strain * rest[:, 2], (1.0, 0.0, 0.0))
        report = self.scene.step(driven_targets_m=[moved[self._mesh.driven_nodes]])
        require(report.status is StepStatus.CONVERGED, "IPC step", report.status, "a solved one")
        forces_n = self.scene._workspace.system.gradient
        # What the driven nodes hold does this work per strain, over the volume.
        return float((forces_n[:, 0] * rest[:, 2]).sum() / (self._area_m2 * self._height_m))


def relaxed_over_theory(rng: np.random.Generator, poisson_ratio: float) -> float:
    """Return the stress over theory's that is most wrong, while a sudden strain is held."""
    block = ShearedBlock(rng, poisson_ratio, 100.0)
    stresses = np.array([block.shear(_STRAIN) for _ in range(300)])
    held_s = block.step_s * (np.arange(len(stresses)) + 0.5)
    decayed = np.exp(-held_s / block.branch.relaxation_time_s)
    return _worst(stresses / (_STRAIN * block.mu_pa * (1.0 + block.branch.modulus_ratio * decayed)))


def creep_force_error(rng: np.random.Generator, poisson_ratio: float) -> float:
    """Return the stress over a constant one that is most wrong, while the strain creeps as theory foretells."""
    block = ShearedBlock(rng, poisson_ratio, 100.0)
    ratio, time_s = block.branch.modulus_ratio, block.branch.relaxation_time_s
    held_s = block.step_s * (np.arange(300) + 0.5)
    crept = 1.0 - ratio / (1.0 + ratio) * np.exp(-held_s / (time_s * (1.0 + ratio)))
    stresses = np.array([block.shear(strain) for strain in (_STRAIN * crept).tolist()])
    return _worst(stresses / (_STRAIN * block.mu_pa))


def loss_over_theory(rng: np.random.Generator, poisson_ratio: float) -> float:
    """Return the energy that a closed cycle of shear costs, over pi strain^2 G'' per volume."""
    block = ShearedBlock(rng, poisson_ratio, 100.0)
    times = float(rng.uniform(0.5, 2.0))  # of the relaxation time in a radian
    count = round(2.0 * np.pi * times * 100.0)
    strains = _STRAIN * np.sin(2.0 * np.pi * np.arange(1, 4 * count + 1) / count)
    stresses = np.array([block.shear(strain) for strain in strains.tolist()])
    last, before = slice(3 * count, None), slice(3 * count - 1, -1)
    cost = float((0.5 * (stresses[last] + stresses[before]) * (strains[last] - strains[before])).sum())
    loss_pa = block.mu_pa * block.branch.modulus_ratio * times / (1.0 + times * times)
    return cost / (np.pi * _STRAIN * _STRAIN * loss_pa)


def _worst(ratios: FloatArray) -> float:
    return float(ratios[np.abs(ratios - 1.0).argmax()])


VISCOUS: dict[str, Callable[[np.random.Generator, float], float]] = {
    "stress while a strain is held, over theory's": relaxed_over_theory,
    "stress over a constant one, while the strain creeps as in theory": creep_force_error,
    "energy that a closed cycle costs, over theory's": loss_over_theory,
}
