"""What an IPC step left behind, assembled anew: nothing here asks the solver whether it solved the step."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from engine_probe import Assembled, Probe
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu
from vitac.envs.fem.contact.overlap import find_overlap
from vitac.envs.fem.model.mesh import PointLoad
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.fem.scene.scene import Scene

# What two orders of summation may make of the same force [N]; contacts carry a few newtons.
SAME_FORCE_N = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Balance:
    """The end of an IPC step.

    Attributes:
        largest_force_n: largest force left on an unknown node or frame point [N].
        jacobian_n_m: exact derivative of these forces [N/m], sparse, shape [3 u, 3 u].
        overlaps: bodies intersect.
    """

    largest_force_n: float
    overlaps: bool
    jacobian_n_m: csc_array

    @property
    def has_negative_determinant(self) -> bool:
        """Whether an odd number of the Jacobian's real eigenvalues is negative; by SuperLU with row exchanges."""
        factors = splu(self.jacobian_n_m)
        exchanges = sum(_sign(order) < 0 for order in (factors.perm_r, factors.perm_c))
        return bool((np.count_nonzero(factors.U.diagonal() < 0) + exchanges) % 2)

    def growing_directions(self) -> tuple[int, int]:
        """How many eigenvalues of the Jacobian have a negative real part, and how many of these are not real.

        A small motion along such a direction drives itself on. None has where the symmetric part is positive definite.
        """
        jacobian = self.jacobian_n_m.toarray()
        symmetric = 0.5 * (jacobian + jacobian.T)
        with contextlib.suppress(np.linalg.LinAlgError):
            np.linalg.cholesky(symmetric)
            return 0, 0
        eigenvalues = np.linalg.eigvals(jacobian)
        growing = eigenvalues[eigenvalues.real < 0]
        return len(growing), int(np.count_nonzero(growing.imag))


def _sign(order: NDArray[np.integer]) -> int:
    """Sign of a permutation."""
    cycles, left = 0, set(range(len(order)))
    while left:
        cycles, place = cycles + 1, left.pop()
        while (place := int(order[place])) in left:
            left.remove(place)
    return 1 if (len(order) - cycles) % 2 == 0 else -1


class BalanceCheck:
    """Looks at a scene from outside, before and after an IPC step."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._probe = scene, Probe(scene)
        self.remember()

    def remember(self) -> None:
        """Take the present state as the start of the next IPC step."""
        time_step_s = self._scene._model.parameters.time_step_s
        self._probe.start_m = self._scene._x.copy()
        self._probe.memory = self._scene._memory
        self._probe.x_hat_m = self._scene._x + time_step_s * self._scene._velocity

    def balance(self, loads: Mapping[int, PointLoad] | None = None) -> Balance:
        """What the IPC step since `remember` has left, with the loads that it was played with."""
        if self._probe.model is not self._scene._model:  # Gels have met, so the matrix has other places.
            before, self._probe = self._probe, Probe(self._scene)
            for name in ("start_m", "x_hat_m", "memory"):
                setattr(self._probe, name, getattr(before, name))
        self._probe.load_n = self._scene._load_n(loads or {})
        here: Assembled = self._probe.at(self._scene._x)
        return Balance(
            largest_force_n=float(np.linalg.norm(here.forces_n.reshape(-1, 3), axis=1).max()),
            jacobian_n_m=here.sparse_matrix_n_m,
            overlaps=find_overlap(self._probe.model.surfaces, self._probe.points_m(self._scene._x)).first_body >= 0,
        )


def assert_honest(report: StepReport, left: Balance, *, tolerance_n: float = 1e-4) -> None:
    """What is called solved balances, would not tip over by itself, and is reported as it is."""
    if report.status is StepStatus.NOT_CONVERGED:
        return
    assert left.largest_force_n <= tolerance_n + SAME_FORCE_N
    assert abs(left.largest_force_n - report.residual_n) <= SAME_FORCE_N
    assert not left.has_negative_determinant
