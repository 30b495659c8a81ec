"""How an IPC step is solved: what is done where plain Newton iterations do not lead there, and what is reported."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from balance_check import BalanceCheck, assert_honest
from block_meshes import box_gel, box_surface
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import IDENTITY, Grip, arena_contact, driven_positions_m
from vitac.envs.fem.model.mesh import GelBody, RigidBody
from vitac.envs.fem.model.settings import CutOffSolverSettings, SolverSettings
from vitac.envs.fem.scene import scene
from vitac.envs.fem.scene.attempt import StepAttempt
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.fem.solver.iterate import IpcStep

FloatArray = NDArray[np.float64]
STANDARD = SolverSettings()
# Two solutions of the same step, each stopped at a move of 1e-8 m.
SAME_M = 1e-7


def pushed(solver: SolverSettings) -> tuple[StepReport, FloatArray]:
    """A gripped box is squeezed and pushed by millimetres in one IPC step: report and node positions."""
    grip = Grip(solver=STANDARD)
    grip.squeeze(2e-4)
    scene = Scene(gels=grip.gels, bodies=[grip.body], time_step_s=0.1, solver=solver)
    scene._x[:], scene._velocity[:] = grip.scene._x, grip.scene._velocity
    lower, upper = np.array([4e-3, 2e-3, 3e-4]), np.array([2e-3, 1e-3, -3e-4])
    report = scene.step(driven_targets_m=[grip.targets_m[0] + lower, grip.targets_m[1] + upper])
    return report, scene._x.copy()


@pytest.fixture(scope="module")
def plain() -> tuple[StepReport, FloatArray]:
    report, x = pushed(STANDARD)
    assert report.status is StepStatus.CONVERGED
    assert report.projected_iterations == 0
    return report, x


def test_reused_factors_end_where_a_newton_step_with_fresh_ones_has_nothing_left_to_move() -> None:
    grip = Grip()
    grip.squeeze(2e-4)
    start, velocity = grip.scene._x.copy(), grip.scene._velocity.copy()
    report = grip.move(np.array([2e-4, 1e-4, 0.0]), np.array([-1e-4, 1e-4, 0.0]))
    assert 0 < report.reusing_iterations < report.newton_iterations
    probe = Probe(grip.scene, start_m=start)
    probe.x_hat_m = start + 0.1 * velocity
    here = probe.at(probe.x_m)
    assert np.abs(here.forces_n).max() < STANDARD.residual_tolerance_n
    assert np.abs(np.linalg.solve(here.matrix_n_m, here.forces_n)).max() < 2 * STANDARD.step_tolerance_m


@pytest.mark.parametrize("iterations", [12, 1])
def test_a_motion_that_goes_on_is_guessed_from_the_one_before_and_ends_in_the_same_state(
    iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a velocity, which is too small to matter for inertia, nothing is guessed; neither after one iteration."""
    aside, ends, solve_motion = np.array([3e-4, 2e-4, 0.0]), [], StepAttempt._solve_motion
    for is_known in (True, False):
        grip = Grip(contact=arena_contact(0.5))
        grip.squeeze(2e-4)
        grip.move(aside, aside)
        scene = grip.scene
        scene._solver = replace(STANDARD, phase_iterations=iterations)
        scene._velocity[:] *= is_known
        guessed: list[bool] = []

        def watched(attempt: StepAttempt, step: IpcStep, *, seen: list[bool] = guessed, **kept: Any) -> int:
            seen.append(step.guesses)
            return solve_motion(attempt, step, **kept)

        monkeypatch.setattr(StepAttempt, "_solve_motion", watched)
        assert grip.move(aside, aside).status is StepStatus.CONVERGED
        ends.append(scene._x.copy())
        assert guessed == [True] * is_known + [False] * (not is_known or iterations == 1)
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=2 * SAME_M)


def test_cautious_iterations_fall_back_on_the_projected_matrix_and_find_the_same_state(
    plain: tuple[StepReport, FloatArray],
) -> None:
    """A free turn of one iteration only, then cautious ones."""
    report, x = pushed(replace(STANDARD, phase_iterations=1, newton_iterations=1000))
    assert report.status is StepStatus.CONVERGED
    assert report.projected_iterations > 0
    assert report.newton_iterations > plain[0].newton_iterations
    np.testing.assert_allclose(x, plain[1], rtol=0, atol=SAME_M)


def test_a_step_that_takes_too_many_iterations_is_divided_and_ends_in_the_same_state(
    plain: tuple[StepReport, FloatArray],
) -> None:
    report, x = pushed(
        replace(STANDARD, newton_iterations=plain[0].newton_iterations - plain[0].reusing_iterations - 1)
    )
    assert report.status is StepStatus.DIVIDED
    assert report.parts > 1
    np.testing.assert_allclose(x, plain[1], rtol=0, atol=SAME_M)


def test_a_step_can_be_divided_from_the_start(plain: tuple[StepReport, FloatArray]) -> None:
    report, x = pushed(replace(STANDARD, first_division_level=2))
    assert report.status is StepStatus.DIVIDED
    assert report.parts == 4
    np.testing.assert_allclose(x, plain[1], rtol=0, atol=SAME_M)


def test_a_cut_off_step_ends_after_its_iterations_near_the_solution(plain: tuple[StepReport, FloatArray]) -> None:
    report, x = pushed(CutOffSolverSettings(iterations_per_step=5))
    assert (report.status, report.parts) == (StepStatus.CUT_OFF, 1)
    assert report.newton_iterations - report.reusing_iterations == 5
    assert report.residual_n > STANDARD.residual_tolerance_n
    assert report.smallest_gap_m > 0
    assert np.abs(x - plain[1]).max() > SAME_M
    solved, same = pushed(CutOffSolverSettings(iterations_per_step=200))
    assert solved.status is StepStatus.CONVERGED
    np.testing.assert_allclose(same, plain[1], rtol=0, atol=SAME_M)


def test_what_is_not_solved_is_called_so_and_stays_apart() -> None:
    report, _ = pushed(replace(STANDARD, newton_iterations=1, division_levels=1))
    assert report.status is StepStatus.NOT_CONVERGED
    assert report.residual_n > STANDARD.residual_tolerance_n
    assert report.smallest_gap_m > 0
    assert report.smallest_det_f > 0


def test_a_step_that_is_not_solved_is_played_as_shorter_ones_with_inertia_and_friction_of_their_own() -> None:
    contact, few = arena_contact(0.5), replace(STANDARD, newton_iterations=5, phase_iterations=5, division_levels=0)
    grip = Grip(contact=contact)
    grip.squeeze(2e-4)
    alone = Scene(gels=grip.gels, bodies=[grip.body], time_step_s=0.1 / 16, contact=contact, solver=few)
    alone.restore(grip.scene.state())
    grip.scene._solver, start_m = few, grip.targets_m
    report = grip.move(np.array([1e-3, 5e-4, 0.0]), np.array([-1e-3, 3e-4, 0.0]))
    assert (report.status, report.parts) == (StepStatus.SHORTENED, 16)
    ways = [(start, end - start) for start, end in zip(start_m, grip.targets_m, strict=True)]
    for part in range(1, 17):
        last = alone.step(driven_targets_m=[start + part / 16 * way for start, way in ways])
        assert last.status is StepStatus.CONVERGED
    assert grip.scene.state_bytes() == alone.state_bytes()
    assert (report.residual_n, report.gel_forces_n) == (last.residual_n, last.gel_forces_n)


def test_a_step_without_a_solution_gives_way_with_less_friction_and_the_next_one_has_all_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In eight iterations it is solved with half of the friction only."""
    few = replace(STANDARD, newton_iterations=8, phase_iterations=8, division_levels=0)
    monkeypatch.setattr(scene, "_SHORTER_STEPS", (1,))
    monkeypatch.setattr(StepAttempt, "follow_balances", lambda *_: (StepStatus.NOT_CONVERGED, 1))
    grip = Grip(contact=arena_contact(2.0))
    grip.squeeze(2e-4)
    half, whole = [
        Scene(gels=grip.gels, bodies=[grip.body], time_step_s=0.1, contact=arena_contact(friction), solver=solver)
        for friction, solver in ((1.0, few), (2.0, STANDARD))
    ]
    half.restore(grip.scene.state())
    grip.scene._solver, motion = few, (np.array([1e-3, 5e-4, 0.0]), np.array([-1e-3, 3e-4, 0.0]))
    assert grip.move(*motion).status is StepStatus.GAVE_WAY
    half.step(driven_targets_m=grip.targets_m)
    assert grip.scene.state_bytes() == half.state_bytes()
    np.testing.assert_array_equal(grip.scene.contact_forces().forces_n, half.contact_forces().forces_n)
    whole.restore(grip.scene.state())
    grip.scene._solver = STANDARD
    grip.move(*(0.1 * each for each in motion))
    whole.step(driven_targets_m=grip.targets_m)
    assert grip.scene.state_bytes() == whole.state_bytes()


@pytest.mark.parametrize("margin_m", [1e-9, 1e-5, 1e-3])
def test_the_answer_does_not_depend_on_the_margin_of_the_candidate_list(
    plain: tuple[StepReport, FloatArray], margin_m: float
) -> None:
    """With next to no margin every iteration makes a new list; with a wide one the first list holds."""
    report, x = pushed(replace(STANDARD, candidate_margin_m=margin_m))
    assert report.active_contacts == plain[0].active_contacts
    np.testing.assert_allclose(x, plain[1], rtol=0, atol=SAME_M)


def test_a_body_that_flies_far_in_one_step_is_caught_by_what_was_not_listed_at_its_start() -> None:
    """A box 5 mm above a plate is thrown at it with 100 mm per step, 500 times the candidate list's margin."""
    gel = GelBody(
        mesh=box_gel((0.004, 0.004, 0.004), (1, 1, 2)), rotation=IDENTITY, translation_m=np.array([1.0, 1.0, 1.0])
    )
    plate = box_surface((0.04, 0.04, 0.002), (-0.02, -0.02, -0.002), "plate")
    box = box_surface((0.01, 0.01, 0.01), (-0.005, -0.005, 0.0), "box")
    flying = RigidBody(mesh=box, rotation=IDENTITY, translation_m=np.array([0, 0, 0.005]), friction=0.3)
    scene = Scene(
        gels=[gel],
        bodies=[RigidBody(mesh=plate, rotation=IDENTITY, translation_m=np.zeros(3), fixed=True), flying],
        time_step_s=0.1,
    )
    scene._velocity[-4:, 2] = -1.0
    report = scene.step(driven_targets_m=[driven_positions_m(gel)])
    assert report.status is not StepStatus.NOT_CONVERGED
    assert report.active_contacts > 0
    assert 0 < scene.body_vertices_m(1)[:, 2].min() < 1e-4


def compressed_column(solver: SolverSettings, *, size: float = 1.0, across: int = 1) -> tuple[StepReport, float]:
    """A slender column pressed beyond its buckling load: report, and how far it bows out as a part of its length.

    It balances when straight, but moves away from there by itself.
    """
    length_m = 0.03 * size
    gel = GelBody(
        mesh=box_gel((0.002 * size, 0.004 * size, length_m), (across, 2, 12), driven="ends"),
        rotation=IDENTITY,
        translation_m=np.zeros(3),
    )
    scene = Scene(gels=[gel], bodies=[], time_step_s=10.0, solver=solver)
    targets = driven_positions_m(gel)
    targets[targets[:, 2] > 0.9 * length_m, 2] -= 0.1 * length_m
    check = BalanceCheck(scene)
    report = scene.step(driven_targets_m=[targets])
    left = check.balance()
    assert_honest(report, left, tolerance_n=solver.residual_tolerance_n)
    bow_m = np.abs(scene.gel_positions_m(0)[:, 0] - gel.mesh.rest_position_m[:, 0]).max()
    return report, float(bow_m / length_m)


# With turns of one iteration the last one is cautious and uses the projected matrix, which looks stable always.
@pytest.mark.slow
@pytest.mark.parametrize("phase_iterations", [STANDARD.phase_iterations, 1])
def test_a_compressed_column_that_stays_straight_is_refused_as_unstable(phase_iterations: int) -> None:
    report, _ = compressed_column(replace(STANDARD, phase_iterations=phase_iterations, saddle_escapes=0))
    assert report.status is StepStatus.NOT_CONVERGED
    assert report.unstable_solutions > 0
    assert report.saddle_escapes == 0


@pytest.mark.parametrize(
    ("changes", "size", "across"),
    [
        ({}, 1.0, 1),
        ({}, 1.0, 2),
        ({}, 5.0, 1),
        ({"phase_iterations": 1}, 1.0, 1),
        ({"phase_iterations": 1, "step_tolerance_m": 1e-5}, 1.0, 1),
    ],
)
def test_a_compressed_column_escapes_its_saddle_and_bows_out(changes: dict[str, Any], size: float, across: int) -> None:
    report, bow = compressed_column(replace(STANDARD, **changes), size=size, across=across)
    assert report.status is StepStatus.ESCAPED_SADDLE
    assert report.saddle_escapes == 1
    assert report.parts == 1
    assert bow > 0.1


def test_an_escape_that_leads_to_no_solution_is_called_so() -> None:
    """So few iterations after the escape lead back to a saddle, and no other escape is allowed."""
    few = replace(STANDARD, division_levels=0, newton_iterations=20, saddle_escapes=1)
    report, _ = compressed_column(few)
    assert (report.status, report.saddle_escapes) == (StepStatus.NOT_CONVERGED, 1)
