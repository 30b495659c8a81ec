"""What an IPC step's CPU time goes into: its kernels, called one by one on states of played episodes.

A piece's time is that of one call, at where an IPC step starts and along the way it goes, times the mean number of such
calls: an iteration makes a matrix and factors, or forces only where it reuses factors. The candidate list is made once.
What is left of the measured time is `other`: inertia and orthogonality, the fitting of steps in cautious iterations,
further candidate lists, and what depends on the iterate.
"""

from collections.abc import Callable
from time import thread_time
from typing import Any

import numpy as np
from vitac.envs.fem.contact.assembly import PointState, add_contacts
from vitac.envs.fem.contact.broad_phase import find_candidates, relative_motion
from vitac.envs.fem.contact.ccd import PointMove, contact_free_fraction, inversion_free_fraction
from vitac.envs.fem.contact.forces import empty_memory
from vitac.envs.fem.elastic.elasticity import add_elasticity
from vitac.envs.fem.elastic.hexahedra import add_hexahedra
from vitac.envs.fem.linear.elimination import factorise, substitute
from vitac.envs.fem.model.model import EXACT_MATRIX, NO_MATRIX, Model, point_positions
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.fem.solver.assembly import State, StepStart, Workspace, assemble, new_workspace

from .replay import Reference, Replay

Figures = dict[str, Any]
FloatArray = np.ndarray[Any, np.dtype[np.float64]]
EPISODES = 3
_CALLS = 20
# How often a call is made in an IPC step.
FACTORISING, REUSING, ANY, ONCE = "factorising", "reusing", "any iteration", "once"
PIECES = {
    "linear solve": (("factorise", FACTORISING), ("substitute", ANY)),
    "elasticity": (("elastic matrix", FACTORISING), ("elastic forces", REUSING)),
    "contacts": (("contact matrix", FACTORISING), ("contact forces", REUSING)),
    "CCD and inversion": (("inversion", ANY), ("impact", ANY)),
    "candidates": (("candidates", ONCE),),
}


def pieces(replay: Replay, reference: Reference) -> list[Figures]:
    """Return the CPU time per IPC step by piece [ms], most of it first, `other` last."""
    samples: list[dict[str, float]] = []
    for episode in reference.log[:EPISODES]:
        sampled = Replay(reference.assets_dir)
        sampled.play(episode, first_steps=0)
        scene = sampled.env.scene
        before = [scene._scene._x.copy()]

        def look(scene: Scene = scene._scene, before: list[FloatArray] = before) -> None:
            samples.append(call_times_ms(scene, before[0], scene._x))
            before[0] = scene._x.copy()

        scene.after_ipc_step = look
        for logged in episode["steps"]:
            sampled.env.step(np.array(logged["action"], dtype=np.float32))
    calls_per_step = _calls_per_step(replay)
    times = {
        piece: sum(float(np.mean([sample[call] for sample in samples])) * calls_per_step[how] for call, how in calls)
        for piece, calls in PIECES.items()
    }
    rows = [{"piece": piece, "ms": ms} for piece, ms in sorted(times.items(), key=lambda item: -item[1])]
    return [*rows, {"piece": "other", "ms": float(np.mean(replay.step_ms)) - sum(times.values())}]


def _calls_per_step(replay: Replay) -> dict[str, float]:
    iterations = float(np.mean([report.newton_iterations for report in replay.reports]))
    reusing = float(np.mean([report.reusing_iterations for report in replay.reports]))
    return {FACTORISING: iterations - reusing, REUSING: reusing, ANY: iterations, ONCE: 1.0}


def call_times_ms(scene: Scene, x: FloatArray, x_end: FloatArray) -> dict[str, float]:
    """Return the CPU time of one call of each kernel at the start x [m] of an IPC step that ends at x_end [ms]."""
    model, w = scene._model, new_workspace(scene._model.system, len(x))
    y, y_move = np.empty((2, len(model.points.node_count), 3))
    point_positions(model.points, x, y)
    point_positions(model.points, x_end - x, y_move)
    reach_m = np.full(len(model.surfaces.pairs), model.parameters.d_hat_m + model.parameters.candidate_margin_m)
    near = find_candidates(model.surfaces, y, reach_m)
    still, motion = np.zeros_like(reach_m), np.empty_like(reach_m)
    relative_motion(model.surfaces, y_move, np.empty((len(model.surfaces.point_start) - 1, 4)), motion)
    points, move = PointState(y, y, still, empty_memory()), PointMove(y, y_move, still, motion)
    assemble(model, near, State(x, y, still), StepStart(x, y, empty_memory(), np.zeros_like(x)), w, EXACT_MATRIX)
    calls: dict[str, Callable[[], object]] = {
        "factorise": lambda: factorise(model.system, w.system.entries, w.factor, False),
        "substitute": lambda: substitute(model.system, w.factor, w.system.right_hand_side.copy()),
        "elastic forces": lambda: _add_elastic(model, x, w, NO_MATRIX),
        "elastic matrix": lambda: _add_elastic(model, x, w, EXACT_MATRIX),
        "contact forces": lambda: add_contacts(model, near, points, w.stencil, w.system, NO_MATRIX),
        "contact matrix": lambda: add_contacts(model, near, points, w.stencil, w.system, EXACT_MATRIX),
        "inversion": lambda: inversion_free_fraction(model.elastic, model.hexahedra, x, x_end - x, 1.0),
        "impact": lambda: contact_free_fraction(near, move, model.parameters.ccd_gap_fraction, 1.0),
        "candidates": lambda: find_candidates(model.surfaces, y, reach_m),
    }
    return {name: _time_ms(call) for name, call in calls.items()}


def _add_elastic(model: Model, x: FloatArray, workspace: Workspace, matrix: int) -> None:
    add_elasticity(model.elastic, x, workspace.batch, workspace.system, matrix)
    add_hexahedra(model.hexahedra, x, workspace.hexahedron, workspace.system, matrix)


def _time_ms(call: Callable[[], object]) -> float:
    call()
    began_s = thread_time()
    for _ in range(_CALLS):
        call()
    return (thread_time() - began_s) / _CALLS * 1e3
