"""How an IPC step is solved: one way after the other, until one leads to its end."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..contact.broad_phase import Candidates
from ..contact.forces import ContactMemory
from ..model.model import PRESCRIBED, Model
from ..model.settings import CutOffSolverSettings, SolverSettings
from ..solver.assembly import Workspace
from ..solver.iterate import IpcStep
from ..solver.newton import SOLVED, UNSOLVED, UNSTABLE, Counter, Record, StepMeasure, Tolerances, forces_at, solve_step
from ..solver.path import BalancePath
from .report import StepStatus

FloatArray = NDArray[np.float64]

# The motion of an IPC step is the first guess of the next one where that of the driven nodes changes by less than this
# part of it, and no node went further than this multiple of it.
_LARGEST_CHANGE, _LONGEST_FOLLOWING = 0.5, 1.2
# Parts of the way from an IPC step's start to its end, where balances are followed along it.
_FIRST_STRIDE, _SHORTEST_STRIDE, _MOST_STRIDES = 1 / 8, 1 / 1024, 100
# Matrices on the path of balances, as a multiple of Newton's iterations.
_PATH_ITERATIONS = 35
# Of the forces held there: what rounding leaves of a balance of kilonewtons over a gap of nanometres.
_UNBALANCED_PART = 1e-8


@dataclass(kw_only=True, eq=False)
class Effort:
    """What an IPC step took, all attempts together."""

    record: Record = field(
        default_factory=lambda: Record(np.zeros(len(Counter), dtype=np.int64), np.zeros(len(StepMeasure)))
    )
    saddle_escapes: int = 0


@dataclass(kw_only=True, eq=False)
class StepAttempt:
    """What an IPC step starts from and goes to, node positions [m] of shape [n, 3], and how it ended.

    Attributes:
        x: where the nodes are; they are moved in place.
        load_n: forces from outside [N], shape [n, 3].
        held: forces [N] of shape [n, 3] that are taken away from the step's own; zero but on the way to its end.
        effort: of the whole IPC step.
        near: candidates where the last motion ended.
        status: of its end.
        parts: into which the driven motion was divided.
    """

    model: Model
    solver: SolverSettings
    workspace: Workspace
    x: FloatArray
    start: FloatArray
    memory: ContactMemory
    x_hat: FloatArray
    target: FloatArray
    load_n: FloatArray
    held: FloatArray
    effort: Effort
    near: Candidates | None = None
    status: StepStatus = StepStatus.NOT_CONVERGED
    parts: int = 1

    def solve(self) -> tuple[StepStatus, int]:
        """Solve in one or more parts, by escaping a saddle or relaxing; how, and in how many parts."""
        s = self.solver
        if isinstance(s, CutOffSolverSettings):
            step = self._towards(self.target)
            is_solved = self._solve_motion(step, iterations=s.iterations_per_step) == SOLVED
            return (StepStatus.CONVERGED if is_solved else StepStatus.CUT_OFF), 1
        if self._continues_motion():
            guess = self._towards(self.target, guesses=True)
            outcome = self._solve_motion(guess, iterations=s.phase_iterations)
            if outcome == SOLVED:
                return StepStatus.CONVERGED, 1
        unstable: tuple[FloatArray, int] | None = None
        for parts in (2**level for level in range(s.first_division_level, s.division_levels + 1)):
            outcome = self._solve_in_parts(parts)
            if outcome == SOLVED:
                return StepStatus.DIVIDED if parts > 1 else StepStatus.CONVERGED, parts
            if outcome == UNSTABLE and unstable is None:
                unstable = self.x.copy(), parts
        if unstable is not None and s.saddle_escapes > 0:
            self.x[:], parts = unstable
            if self._escape_saddles():
                return StepStatus.ESCAPED_SADDLE, parts
        self.x[:] = self.start
        if self._solve_motion(self._towards(self.target, relaxes=True)) == SOLVED:
            return StepStatus.RELAXED, 1
        return StepStatus.NOT_CONVERGED, 1

    def follow_balances(self) -> tuple[StepStatus, int]:
        """Solve by following balances from the start; as `solve`."""
        is_solved = self._continue_from_start() or self._follow_path()
        return (StepStatus.CONTINUED if is_solved else StepStatus.NOT_CONVERGED), 1

    def _continues_motion(self) -> bool:
        """Return whether the driven nodes move about as in the IPC step before, in which no node went much further."""
        if not self.model.parameters.remembers_slip:
            return False
        before_m, prescribed = self.x_hat - self.start, self.model.unknowns.slot == PRESCRIBED
        driven_m = (self.target - self.start)[prescribed]
        largest_m = np.abs(driven_m).max()
        differs = np.abs(driven_m - before_m[prescribed]).max() >= _LARGEST_CHANGE * largest_m
        return bool(not differs and np.abs(before_m).max() < _LONGEST_FOLLOWING * largest_m)

    def _solve_in_parts(self, parts: int) -> int:
        """Solve along intermediate driven positions, each from the solution of the one before; how the last one ended.

        An intermediate one that ends without a stable solution is the last one, and counts as not solved.
        """
        self.x[:] = self.start
        for part in range(1, parts):
            waypoint = self.start + (part / parts) * (self.target - self.start)
            if self._solve_motion(self._towards(waypoint)) != SOLVED:
                return UNSOLVED
        return self._solve_motion(self._towards(self.target))

    def _escape_saddles(self) -> bool:
        """Leave the unstable equilibrium that the scene is in, and any that this leads to."""
        for _ in range(self.solver.saddle_escapes):
            self.effort.saddle_escapes += 1
            outcome = self._solve_motion(self._towards(self.target, escapes_saddle=True))
            if outcome != UNSTABLE:
                return outcome == SOLVED
        return False

    def _continue_from_start(self) -> bool:
        """Follow balances along the step: at its start forces are held that make this one, at its end none.

        The strides halve where one leads to no stable balance; the shortest ones jump to the next by relaxing.
        """
        self.x[:] = self.start
        unbalanced = forces_at(self.model, self.x, self._towards(self.start), self.workspace)
        residual_n = max(self.solver.residual_tolerance_n, _UNBALANCED_PART * float(np.abs(unbalanced).max()))
        part, stride, solved_before = 0.0, _FIRST_STRIDE, False
        for _ in range(_MOST_STRIDES):
            before, following = self.x.copy(), min(1.0, part + stride)
            waypoint = self.start + following * (self.target - self.start)
            self.held, shortest = (1.0 - following) * unbalanced, stride <= _SHORTEST_STRIDE
            step = self._towards(waypoint, relaxes=shortest)
            if self._solve_motion(step, residual_n=residual_n) == SOLVED:
                part, stride, solved_before = following, 2.0 * stride if solved_before else stride, True
            elif shortest:
                break
            else:
                self.x[:], stride, solved_before = before, 0.5 * stride, False
            if part == 1.0:
                return True
        self.held = np.zeros_like(unbalanced)
        return self._solve_motion(self._towards(self.target)) == SOLVED

    def _follow_path(self) -> bool:
        """Follow the path of balances from the start, also where it turns back; the state stays where that fails."""
        before, step = self.x.copy(), self._towards(self.target)
        self.x[:] = self.start
        unbalanced = forces_at(self.model, self.x, self._towards(self.start), self.workspace)
        path = BalancePath(self.model, self.x, step, unbalanced, self.workspace)
        arrived = path.follow(_PATH_ITERATIONS * self.solver.newton_iterations)
        self.effort.record.counts[Counter.ITERATIONS] += path.iterations
        if arrived and self._solve_motion(step) == SOLVED:
            return True
        self.x[:] = before
        left_n = forces_at(self.model, self.x, step, self.workspace)[self.model.unknowns.node]
        residual_n = float(np.sqrt((left_n * left_n).sum(axis=1)).max())
        self.effort.record.measures[:] = residual_n, *self.workspace.smallest
        return False

    def _towards(
        self,
        waypoint: FloatArray,
        *,
        escapes_saddle: bool = False,
        relaxes: bool = False,
        guesses: bool = False,
    ) -> IpcStep:
        """Return the step with other targets of the prescribed nodes."""
        held = self.load_n + self.held
        return IpcStep(self.start, self.memory, self.x_hat, waypoint, escapes_saddle, relaxes, guesses, held)

    def _solve_motion(
        self,
        step: IpcStep,
        *,
        iterations: int | None = None,
        residual_n: float | None = None,
    ) -> int:
        s = self.solver
        most = s.newton_iterations if iterations is None else iterations
        residual_n = s.residual_tolerance_n if residual_n is None else residual_n
        tolerances = Tolerances(s.step_tolerance_m, residual_n, most, s.phase_iterations)
        outcome, self.near = solve_step(self.model, self.x, step, tolerances, self.workspace, self.effort.record)
        return outcome
