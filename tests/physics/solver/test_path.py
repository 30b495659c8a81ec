"""The path of balances ends where the plain solution is, and what does not arrive leaves the state as it was."""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import Grip
from vitac.envs.fem.model.settings import SolverSettings
from vitac.envs.fem.scene import attempt
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.fem.scene.scene import Scene

# No turn of Newton's method leads anywhere; one iteration ends what the path has brought near.
HOPELESS = replace(SolverSettings(), newton_iterations=1, division_levels=0)


def pushed(solver: SolverSettings) -> tuple[StepReport, Scene]:
    """A gripped box is pushed on in one IPC step."""
    grip = Grip()
    grip.squeeze(2e-4)
    pushed = Scene(gels=grip.gels, bodies=[grip.body], time_step_s=0.1, solver=solver)
    pushed._x[:], pushed._velocity[:] = grip.scene._x, grip.scene._velocity
    motion = np.array([2e-4, 1e-4, 0.0])
    return pushed.step(driven_targets_m=[place + motion for place in grip.targets_m]), pushed


@pytest.fixture(autouse=True)
def only_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing else continues from the start."""
    monkeypatch.setattr(attempt.StepAttempt, "_continue_from_start", lambda *_: False)


def test_the_path_leads_to_the_state_that_newtons_method_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attempt, "_PATH_ITERATIONS", 1000)
    plain, there = pushed(SolverSettings())
    assert plain.status is StepStatus.CONVERGED
    report, found = pushed(HOPELESS)
    assert report.status is StepStatus.CONTINUED
    assert report.residual_n <= HOPELESS.residual_tolerance_n
    np.testing.assert_allclose(found._x, there._x, rtol=0, atol=1e-7)


def test_a_path_that_is_too_long_leaves_the_state_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(attempt, "_PATH_ITERATIONS", 0)
    without, left = pushed(HOPELESS)
    monkeypatch.setattr(attempt, "_PATH_ITERATIONS", 5)
    report, found = pushed(HOPELESS)
    assert report.status is without.status is StepStatus.NOT_CONVERGED
    assert report.residual_n == without.residual_n
    assert (found._x == left._x).all()
