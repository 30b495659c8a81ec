"""Follows the path of balances from an IPC step's start to its end, also where it turns back; called by `scene`.

Forces that balance the start are held, and let go in proportion to the driven motion. With a friction coefficient of 44
a balance ends within 0.1 um where a contact takes hold or lets go, and the next one lies elsewhere, so that no division
of the motion leads there; but the path of balances turns back and arrives. It is followed along its own length
(pseudo-arclength continuation: Allgower & Georg, Introduction to Numerical Continuation Methods, 1990), forward where
the determinant of the Jacobian is positive and back where it is negative: the balance at its end has a positive one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel
from ..linear.elimination import factorise, has_negative_determinant, substitute
from ..model.model import EXACT_MATRIX, Model, point_positions
from .assembly import Workspace, assemble
from .iterate import (
    LONGEST_MOVE_M,
    IpcStep,
    feasible_fraction,
    list_candidates,
    look_ahead,
    make_step,
    new_solve,
    shorten_long_move,
    write_remaining_motion,
)

FloatArray = NDArray[np.float64]

# Mean motion of the unknowns that counts as much as the whole way [m].
_SCALE_M = 1e-3
_FIRST_STRIDE, _LONGEST_STRIDE, _SHORTEST_STRIDE = 1 / 16, 1 / 4, 1e-10
_CORRECTIONS = 8
# A stride becomes longer where few corrections lead back to the path.
_LENGTHENING = {1: 4.0, 2: 4.0, 3: 4.0, 4: 2.0}
# Largest first correction, as a part of the stride, and largest last one [m], which leaves less than the shortest
# stride. Each is at most half of the one before.
_NEAR, _ARRIVED_M = 0.3, 1e-9
# Where two tangents have a smaller scalar product, there is a bend between them.
_BEND = 0.7


class Tangent(NamedTuple):
    """Direction of the path, per length."""

    motion: FloatArray  # [3 u] of the unknowns [m]
    part: float  # of the way; negative where the path goes back


class BalancePath:
    """The path of balances from the nodes of an IPC step's start, which `follow` moves.

    Args:
        model: of the scene.
        x: nodes [m], shape [n, 3].
        step: what is to be solved.
        unbalanced: forces of the step at these nodes [N], shape [n, 3].
        workspace: of the scene.

    Attributes:
        iterations: matrices that were factorised.
    """

    def __init__(
        self, model: Model, x: FloatArray, step: IpcStep, unbalanced: FloatArray, workspace: Workspace
    ) -> None:
        self._model, self._x, self._unbalanced, self._workspace = model, x, unbalanced, workspace
        self._load_n = step.held
        self._start, self._driven = x.copy(), np.zeros_like(x)
        write_remaining_motion(model, x, step.x_target, self._driven)
        self._solve = new_solve(model, x, step._replace(held=step.held.copy()))
        self._candidates = list_candidates(model, self._solve)
        unknowns = 3 * len(model.unknowns.node)
        self._correction, self._per_part = np.empty(unknowns), np.empty(unknowns)
        self._part, self._scale2 = 0.0, _SCALE_M * _SCALE_M * unknowns
        self._beyond: Tangent | None = None
        self.iterations = 0

    def follow(self, iterations: int) -> bool:
        """Move the nodes along the path; return whether they arrived at its end within so many iterations."""
        stride, tangent, before, part = _FIRST_STRIDE, None, self._x, self._part
        while stride >= _SHORTEST_STRIDE and self.iterations < iterations:
            if tangent is None:
                if not self._linearise():
                    return False
                tangent, before, part = self._tangent(), self._x.copy(), self._part
            corrections = self._go(tangent, stride) or self._go_round_bend(tangent, stride, before, part)
            if corrections and self._part == 1.0:
                return True
            if corrections:
                stride, tangent = min(_LONGEST_STRIDE, _LENGTHENING.get(corrections, 1.0) * stride), None
            else:
                self._go_back(before, part)
                stride *= 0.5
        return False

    def _go_round_bend(self, tangent: Tangent, stride: float, before: FloatArray, part: float) -> int:
        """Make a stride that failed as the path goes on beyond its end, if it turns back between; as `_go`."""
        beyond = self._beyond
        if beyond is None or not self._turns_back(tangent, beyond):
            return 0
        self._go_back(before, part)
        corrections = self._go(beyond, stride)
        # What lies on the side that the path came from is no progress.
        return corrections if (self._tangent().part < 0.0) == (beyond.part < 0.0) else 0

    def _tangent(self) -> Tangent:
        """Return the direction at the place that was linearised last."""
        sign = -1.0 if has_negative_determinant(self._workspace.factor) else 1.0
        part = sign / float(np.sqrt(product(self._per_part, self._per_part) / self._scale2 + 1.0))
        return Tangent(part * self._per_part, part)

    def _turns_back(self, tangent: Tangent, beyond: Tangent) -> bool:
        along = product(tangent.motion, beyond.motion) / self._scale2 + tangent.part * beyond.part
        return along < _BEND and (tangent.part < 0.0) != (beyond.part < 0.0)

    def _go(self, tangent: Tangent, stride: float) -> int:
        """Make a stride and return to the path, at right angles or at its end; corrections made, 0 where it fails."""
        self._beyond = None
        arrives = self._part + stride * tangent.part >= 1.0
        along = (1.0 - self._part) / tangent.part if arrives else stride
        longest = along * float(np.abs(tangent.motion).max())
        if self._move(along * tangent.motion, along * tangent.part, arrives=arrives) < 1.0:
            return 0
        largest = _NEAR * longest
        for count in range(1, _CORRECTIONS + 1):
            if not self._linearise():
                return 0
            self._beyond = self._beyond or self._tangent()
            change = 0.0 if arrives else self._change(tangent)
            move = self._correction + change * self._per_part
            size = float(np.abs(move).max())
            if not size <= largest:
                return 0
            fraction, largest = self._move(move, change, arrives=arrives), 0.5 * size
            if fraction == 1.0 and size <= _ARRIVED_M:
                return count
        return 0

    def _change(self, tangent: Tangent) -> float:
        """Return by how much a correction at right angles to the path changes the part of the way."""
        ahead = product(tangent.motion, self._per_part) + tangent.part * self._scale2
        return -product(tangent.motion, self._correction) / ahead

    def _move(self, motion: FloatArray, part: float, *, arrives: bool) -> float:
        """Move the nodes as far as contact allows; return how far, 0 for a motion that is too long."""
        model, s = self._model, self._solve
        s.step.x[:] = part * self._driven
        s.step.x[model.unknowns.node] = motion.reshape(-1, 3)
        if not shorten_long_move(model, s.step) <= LONGEST_MOVE_M:
            return 0.0
        if not look_ahead(model, s):
            self._candidates = list_candidates(model, s)
        fraction = feasible_fraction(model, self._candidates, s)
        self._part = 1.0 if arrives and fraction == 1.0 else self._part + fraction * part
        make_step(model, s, fraction, self._start + self._part * self._driven, True)
        return fraction

    def _go_back(self, x: FloatArray, part: float) -> None:
        self._x[:], self._part = x, part
        point_positions(self._model.points, x, self._solve.iterate.y)
        self._candidates = list_candidates(self._model, self._solve)

    def _linearise(self) -> bool:
        """Write the Newton correction, and the motion per part of the way; False where the matrix is singular."""
        self.iterations += 1
        self._solve.start.held[:] = self._load_n + (1.0 - self._part) * self._unbalanced
        self._workspace.system.prescribed_move[:] = self._driven
        model, s, system, factor = self._model, self._solve, self._workspace.system, self._workspace.factor
        assemble(model, self._candidates, s.iterate, s.start, self._workspace, EXACT_MATRIX)
        self._correction[:] = -system.gradient[model.unknowns.node].ravel()
        self._per_part[:] = -(system.coupling + self._unbalanced)[model.unknowns.node].ravel()
        if not factorise(model.system, system.entries, factor, False):
            return False
        substitute(model.system, factor, self._correction)
        substitute(model.system, factor, self._per_part)
        return True


@allocating_kernel
def product(a: FloatArray, b: FloatArray) -> float:
    """Return the scalar product, summed in the same order on all machines."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total
