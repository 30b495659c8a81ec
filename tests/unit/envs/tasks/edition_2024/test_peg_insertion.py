"""The pegs of 2024 on a stand-in for the physics: what differs from 2025, and the boundaries of success and ends."""

from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.geometry.pegs_2024 import PegShape2024
from vitac.envs.tasks.definition import Flags
from vitac.envs.tasks.edition_2024.env import PegInsertion2024Env, accepts_start, is_blocked, judge_peg_flags
from vitac.envs.tasks.insertion.env import InsertionState
from vitac.envs.tasks.insertion.interface import PegOffset
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError

START = {"shape": "concave2", "offset_mm_deg": (0.0, 0.0, 0.0), "rng_seed": (0, 1)}
REST = [0.0, 0.0, 0.0]


def played(*actions: list[float], options: dict[str, Any] | None = None, **settings: Any) -> tuple[Any, ...]:
    env = PegInsertion2024Env(**settings)
    result: tuple[Any, ...] = env.reset(options=START | (options or {}))
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


def flags(
    *, env_steps: int = 3, x_mm: float = 0.0, diff_m: tuple[float, float] = (1e-4, 1e-4), z_mm: float = -0.31
) -> Flags:
    state = InsertionState(
        env_steps=env_steps,
        offset=PegOffset(x_mm=x_mm, y_mm=0.0, theta_deg=0.0),
        surface_diff_m=np.array(diff_m),
        peg_relative_z_mm=np.array([-0.5, z_mm]),
    )
    return judge_peg_flags(state, max_steps=8, z_step_mm=0.125)


@pytest.mark.parametrize(
    ("changes", "success"),
    [
        ({}, True),
        ({"env_steps": 2}, False),
        ({"env_steps": 8}, True),
        ({"env_steps": 9}, False),
        ({"z_mm": -0.3}, False),
        ({"diff_m": (0.999e-3, 0.999e-3)}, True),
        ({"diff_m": (1e-3, 0.0)}, False),
        ({"diff_m": (0.0, 1e-3)}, False),
        ({"x_mm": 12.000009}, True),
        ({"x_mm": 12.00002}, False),
    ],
)
def test_success_needs_depth_calm_gels_and_range_up_to_the_last_env_step(
    changes: dict[str, Any], *, success: bool
) -> None:
    assert flags(**changes).is_success is success


def test_motion_of_the_gels_ends_nothing(physics: list[FakeScene]) -> None:
    env, *_ = played(REST, REST)
    physics[0].bulge_m = 1.6e-3
    _, reward, terminated, truncated, info = env.step(np.zeros(3, np.float32))
    assert (reward, terminated, truncated, info["end_reason"]) == (-1.0, False, False, None)
    assert info["observation_check_m"] == pytest.approx([1.6e-3] * 2)
    assert "tactile_movement_too_large" not in info
    physics[0].bulge_m = 0.9e-3
    _, reward, terminated, _, info = env.step(np.zeros(3, np.float32))
    assert (reward, terminated, info["is_success"]) == (9.0, True, True)


def test_last_env_step_may_succeed_and_ends_the_episode_either_way(physics: list[FakeScene]) -> None:
    env, *_, terminated, truncated, info = played(*[REST] * 8)
    assert (terminated, truncated, info["end_reason"], info["too_many_steps"]) == (True, True, "success", False)
    physics[0].bulge_m = 2e-3
    _, reward, terminated, truncated, info = env.step(np.zeros(3, np.float32))
    assert (reward, terminated, truncated, info["too_many_steps"]) == (0.0, False, True, True)
    assert info["observation_check_m"].tolist() == [-1.0, -1.0]


def test_offset_out_of_range_terminates() -> None:
    _, _, reward, terminated, truncated, info = played([1, 0, 0], options={"offset_mm_deg": (11.0, 0.0, 0.0)})
    assert (terminated, truncated, info["end_reason"], info["is_success"]) == (True, False, "error", False)
    assert reward == pytest.approx(-2.0 - 1.0 - 2.0 * 7 + 1.0)
    assert info["observation_check_m"].tolist() == [-1.0, -1.0]


def test_gels_have_the_friction_of_the_class_default_and_policies_see_no_motion(physics: list[FakeScene]) -> None:
    env, observation, _ = played()
    assert {gel.friction for gel in physics[0].gels} == {0.5}
    assert set(observation) == {"marker_flow"}
    assert env.ipc_steps == 4
    _, seen, _ = played(privileged=True)
    assert seen["shape"].tolist() == [list(PegShape2024).index(PegShape2024.CONCAVE2)]


@pytest.mark.parametrize("shape", PegShape2024)
def test_every_shape_is_placed_with_its_hole(physics: list[FakeScene], shape: PegShape2024) -> None:
    _, _, info = played(options={"shape": shape.value}, clearance_mm=2.5)
    peg, plate = physics[0].bodies
    assert len(info["peg_relative_z_mm"]) == len(peg.mesh.vertices_m) // 2
    assert np.allclose(info["peg_relative_z_mm"], -0.125)
    assert np.ptp(plate.mesh.vertices_m, axis=0) == pytest.approx([0.07, 0.05, 0.02])


@pytest.mark.parametrize(
    ("shape", "clearance_mm", "offset", "blocked"),
    [
        ("hexagon", 1.5, (2.1, 0.0, 0.0), True),  # the peg is 0.32 mm off in x, its hole is not
        ("hexagon", 1.5, (-1.5, 0.0, 0.0), True),
        ("hexagon", 1.5, (2.0, 0.0, 0.0), False),
        ("concave2", 0.5, (0.0, 0.0, 0.0), False),  # 0.5 mm of room at the flank on the left, 0.5 mm off in x
        ("concave2", 0.5, (-0.1, 0.0, 0.0), True),
        ("concave2", 0.5, (3.4, 0.0, 0.0), False),  # 2.5 mm of room at all others
        ("concave2", 0.5, (3.6, 0.0, 0.0), True),
        ("octagon", 1.5, (1.4, 0.0, 0.0), False),
        ("octagon", 1.5, (1.6, 0.0, 0.0), True),
    ],
)
def test_what_is_blocked_follows_the_uneven_holes(
    shape: str, clearance_mm: float, offset: tuple[float, float, float], *, blocked: bool
) -> None:
    x_mm, y_mm, theta_deg = offset
    placed = PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)
    assert bool(is_blocked(PegShape2024(shape), placed, clearance_mm)) is blocked


def test_starts_are_drawn_of_seven_shapes_where_they_are_blocked() -> None:
    env = PegInsertion2024Env(privileged=True)
    drawn = [env.reset(seed=seed)[0] for seed in range(40)]
    assert {int(each["shape"][0]) for each in drawn} == set(range(7))
    for each in drawn:
        assert accepts_start(list(PegShape2024)[int(each["shape"][0])], tuple(each["gt_offset"].tolist()))


def test_shapes_of_others_and_other_forms_are_refused() -> None:
    with pytest.raises(ResetOptionsError, match=r"PegInsertion2024-v1.*expected one of concave1, concave2, convex"):
        PegInsertion2024Env().reset(options={"shape": "triangle"})
    with pytest.raises(SettingsError, match="no other form"):
        PegInsertion2024Env(peg_taper=0.1)
