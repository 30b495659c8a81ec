"""Another material is a module like `neo_hookean` and one changed import: shown for St. Venant and Kirchhoff's."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import elastic_probe
import numpy as np
import pytest
import st_venant_kirchhoff
import vitac.envs
from elastic_probe import block
from numpy.typing import NDArray
from vectors import differences
from vitac.envs.fem.elastic.neo_hookean import lame_parameters_pa

FloatArray = NDArray[np.float64]
ENVS = Path(vitac.envs.__file__).parent
MU, LAMBDA = lame_parameters_pa(3e5, 0.3)
STEP_M = 1e-7


def energy(x: FloatArray) -> float:
    """Of the block at node positions x [m], from the formula of the material [J]."""
    mesh = block()
    F = np.einsum("tai,taj->tij", x[mesh.tetrahedra], mesh.rest_gradients_1_m)
    E = 0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3))
    trace = np.trace(E, axis1=1, axis2=2)
    return float((mesh.volumes_m3 * (MU * (E * E).sum(axis=(1, 2)) + 0.5 * LAMBDA * trace**2)).sum())


@pytest.fixture(scope="module")
def strained() -> FloatArray:
    """Node positions of the block, strained by a tenth or so, not everywhere alike [m]."""
    rest = block().rest_position_m
    stretched = rest @ np.array([[1.1, 0.2, 0.0], [0.0, 0.9, 0.1], [0.05, 0.0, 0.92]])
    return np.asarray(stretched + 1e-4 * np.sin(2e3 * rest[:, ::-1]))


@pytest.fixture(scope="module")
def found(strained: FloatArray, tmp_path_factory: pytest.TempPathFactory) -> dict[str, FloatArray]:
    """What a copy of our sources finds in which only the material was exchanged."""
    folder = tmp_path_factory.mktemp("second_material")
    elastic = folder / "vitac" / "envs" / "fem" / "elastic"
    shutil.copytree(ENVS, folder / "vitac" / "envs", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(st_venant_kirchhoff.__file__, elastic)
    summed = (elastic / "elasticity.py").read_text()
    assert summed.count("from .neo_hookean import ") == 1
    changed = summed.replace("from .neo_hookean import ", "from .st_venant_kirchhoff import ")
    (elastic / "elasticity.py").write_text(changed)
    unknowns = [(i, k) for i in range(len(strained)) for k in range(3)]
    steps = np.zeros((len(unknowns), *strained.shape))
    for n, (i, k) in enumerate(unknowns):
        steps[n, i, k] = STEP_M
    states = np.concatenate([strained[None], strained + steps, strained - steps])
    np.savez(folder / "states.npz", x=states)
    support = Path(elastic_probe.__file__)
    subprocess.run(
        [sys.executable, str(support), str(folder / "states.npz"), str(folder / "results.npz")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(support.parent)])},
        check=True,
    )
    return dict(np.load(folder / "results.npz"))


def test_forces_are_the_derivative_of_the_second_materials_energy(
    strained: FloatArray, found: dict[str, FloatArray]
) -> None:
    expected = differences(energy, strained, 1e-6)
    np.testing.assert_allclose(found["forces"][0], expected, atol=1e-8 * np.abs(expected).max())


def test_its_matrix_is_the_derivative_of_its_forces(found: dict[str, FloatArray]) -> None:
    unknowns = found["unknowns"].astype(int)
    moved = found["forces"][1:]
    ahead, behind = moved[: len(moved) // 2], moved[len(moved) // 2 :]
    derivative = ((ahead - behind) / (2 * STEP_M)).reshape(-1, 3, *ahead.shape[1:])[unknowns][:, :, unknowns]
    expected = derivative.reshape(3 * len(unknowns), -1).T
    np.testing.assert_allclose(found["exact"], expected, atol=1e-6 * np.abs(expected).max())


def test_its_replacement_is_positive_semi_definite_and_differs(found: dict[str, FloatArray]) -> None:
    projected = found["projected"]
    assert np.linalg.eigvalsh(projected).min() > -1e-9 * np.abs(projected).max()
    assert np.abs(projected - found["exact"]).max() > 1e-3 * np.abs(projected).max()
