"""IPC steps that Newton's turns do not solve: first touches of a key, one that wedges, a gel that is squeezed flat."""

from typing import Any

import gymnasium
import numpy as np
import own_sensors
import pytest
import vitac.envs
from balance_check import BalanceCheck, assert_honest
from unsolved import played
from vitac.envs.fem.scene.report import StepReport, StepStatus
from vitac.envs.fem.scene.scene import Scene
from vitac.envs.tactile.gel import GelDimensions, structured_gel

pytestmark = pytest.mark.slow

PULL_AND_PRESS = np.array([-1, 1], dtype=np.float32)


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> None:
    """IPC steps that are relaxed or continued are looked at from outside."""
    step = Scene.step

    def checked_step(scene: Scene, **targets: Any) -> StepReport:
        check = BalanceCheck(scene)
        report = step(scene, **targets)
        if report.status in {StepStatus.RELAXED, StepStatus.CONTINUED}:
            left = check.balance()
            assert_honest(report, left)
            assert not left.overlaps
            assert left.growing_directions() == (0, 0)
        return report

    monkeypatch.setattr(Scene, "step", checked_step)


@pytest.fixture
def env(checked: None) -> Any:
    """Lock opening."""
    made: Any = gymnasium.make("ViTac/LockOpening-v1", disable_env_checker=True, observation_keys=()).unwrapped
    assert made.env_id in vitac.envs.ENVIRONMENTS
    return made


@pytest.mark.parametrize(
    ("seed", "options"),
    [
        (None, {"shape": "key2", "offset_mm": (2.5, 0, 0), "rng_seed": (1005, 70)}),
        (None, {"shape": "key1", "offset_mm": (2.25, 0, 0), "rng_seed": (1008, 9)}),
        (459, {}),
    ],
)
def test_first_touches_are_relaxed_to_a_stable_balance(env: Any, seed: int | None, options: dict[str, Any]) -> None:
    _, info = env.reset(seed=seed, options=options)
    assert info["end_reason"] is None
    first, *others = info["step_reports"]
    assert first.status is StepStatus.RELAXED
    assert first.parts == 1
    assert [report.status for report in others] == [StepStatus.CONVERGED] * 2


def test_a_key_pulled_and_pressed_down_is_relaxed_to_a_stable_balance(env: Any) -> None:
    env.reset(options={"shape": "key1", "offset_mm": (1.5, 0, 0), "rng_seed": (1010, 6)})
    for _ in range(6):
        *_, info = env.step(PULL_AND_PRESS)
    assert env.scene.solved
    assert StepStatus.RELAXED in [report.status for report in info["step_reports"]]


def test_a_thin_gel_that_is_squeezed_flat_is_followed_along_balances(checked: None) -> None:
    """Random actions press tetrahedra of a gel of 2 mm to 3 to 15 % of their volume."""
    gel = structured_gel(name="thin", size=GelDimensions(thickness_mm=2.0))
    env: Any = gymnasium.make("ViTac/PegInsertion-v1", disable_env_checker=True, observation_keys=(), gel=gel)
    statuses = played(env.unwrapped, 34, 20)
    assert StepStatus.CONTINUED in statuses
    assert StepStatus.NOT_CONVERGED not in statuses


def test_soft_tips_that_fold_are_followed_where_the_path_of_balances_turns_back() -> None:
    sensor = own_sensors.designed("pyramids")
    env: Any = gymnasium.make("ViTac/PegInsertion-v1", disable_env_checker=True, observation_keys=(), sensor=sensor)
    statuses = played(env.unwrapped, 22, 20)
    assert StepStatus.CONTINUED in statuses
    assert StepStatus.NOT_CONVERGED not in statuses
