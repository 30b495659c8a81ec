"""The fusion environment on a stand-in for the physics: placement, commands, pictures, info and refusals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.tasks.definition import Flags, UnknownObservationKey
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionEnv, FusionOffset, FusionStart, Target, judge_flags
from vitac.envs.tasks.insertion.env import InsertionState
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError
from vitac.envs.vision.observables import SEGMENTATION
from vitac.envs.vision.rasterizer import Label

LEFT = {"start": (2.0, -4.0, 6.0, 5.0, 1), "rng_seed": (0, 1)}
NOMINAL: dict[str, Any] = {}
RIGHT = {"start": (2.0, -4.0, 6.0, 5.0, 0), "rng_seed": (0, 1)}
PUBLIC = [
    *("relative_motion", "rgb_picture", "depth_picture", "point_cloud", "object_point_cloud"),
    "marker_flow",
]


def played(*actions: list[float], options: dict[str, Any] = LEFT, **settings: Any) -> tuple[Any, ...]:
    env = FusionInsertionEnv(**({"depth_mode": "gt"} | settings))
    result: tuple[Any, ...] = env.reset(options=options)
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


def test_peg_stands_one_millimetre_and_z_above_the_rim_in_the_middle_between_the_holes(
    physics: list[FakeScene],
) -> None:
    for options, vertices in ((LEFT, 12), (RIGHT, 8)):
        played(options=options)
        peg, base = physics[-1].bodies
        assert peg.translation_m == pytest.approx([2e-3, 18.625e-3, (17.4 + 6.0) * 1e-3])
        assert peg.rotation[:, 0] == pytest.approx([np.cos(np.radians(6)), np.sin(np.radians(6)), 0])
        assert len(peg.mesh.vertices_m) == vertices
        assert (peg.friction, base.friction, peg.fixed, base.fixed) == (9.5, 0.5, False, True)


def test_reset_takes_two_ipc_steps_to_grasp_and_comes_down_by_none(physics: list[FakeScene]) -> None:
    env, _, info = played()
    assert env.ipc_steps == len(info["step_reports"]) == 2
    heights_m = [float(np.mean(targets, axis=(0, 1))[2]) for targets in physics[0].targets_m]
    assert heights_m == pytest.approx([(17.4 + 6.0 + 42.0) * 1e-3] * 2)


def test_action_moves_all_four_together_clipped_and_turned(physics: list[FakeScene]) -> None:
    *_, info = played([0.5, 7.0, -0.25, -0.5])
    sine, cosine = np.sin(np.radians(6.0)), np.cos(np.radians(6.0))
    expected = [0.5 * cosine - 1.0 * sine, 0.5 * sine + 1.0 * cosine, -0.25, -0.5]
    assert info["relative_motion_mm_deg"] == pytest.approx(expected)
    assert info["gt_offset_mm_deg"] == pytest.approx(np.array([2.0, -4.0 + 22.625 - 45.25, 6.0, 15.5]) + expected)
    assert info["peg_relative_z_mm"] == pytest.approx([5.5] * 6)
    centres_m = [centre for _, centre in physics[0].placed]
    assert np.mean(centres_m, axis=0) * 1e3 == pytest.approx([2.0 + expected[0], 18.625 + expected[1], 65.4 - 0.5])


@pytest.mark.parametrize(
    ("action", "steps"),
    [([0, 0, 0, 0], 1), ([1, 0, 0, 0], 2), ([1, 1, 0, 0], 3), ([0, 0, 1, 0], 1), ([0, 0, 0, -1], 2), ([1, 1, 1, 1], 3)],
)
def test_env_step_takes_the_stated_number_of_ipc_steps(action: list[float], steps: int) -> None:
    *_, info = played(action, options=LEFT | {"start": (0, 0, 45 / 2 - 5, 5, 1)})
    assert len(info["step_reports"]) == steps


def test_observation_has_the_challenges_keys_in_its_order() -> None:
    env, observation, _ = played()
    assert list(observation) == PUBLIC
    assert observation in env.observation_space
    _, privileged, _ = played(privileged=True, options=RIGHT)
    assert list(privileged) == [
        "gt_direction",
        "gt_offset",
        *PUBLIC,
        "shape",
        "measured_pose",
        "contact_forces",
        "surface_pts",
    ]
    assert privileged["gt_direction"].tolist() == [-1.0]
    assert privileged["gt_offset"] == pytest.approx([2.0, 18.625, 6.0, 15.5])


def test_pictures_of_an_observation_belong_together() -> None:
    env, observation, info = played(observables=(SEGMENTATION,))
    label = observation["segmentation"]
    of_variants = {Label.CLUTTER_OF_BASE, Label.CLUTTER_OF_PEG, Label.TABLE, Label.WALL}
    assert set(np.unique(label)) == set(Label) - of_variants
    np.testing.assert_array_equal(observation["depth_picture"] > 0, label != Label.NOTHING)
    np.testing.assert_array_equal(observation["point_cloud"][..., 2], observation["depth_picture"])
    np.testing.assert_array_equal((observation["rgb_picture"] < 255).any(axis=2), label != Label.NOTHING)
    assert (info["peg_seen"], info["base_seen"]) == (True, True)
    assert observation in env.observation_space


def test_pictures_show_the_deformed_gels(physics: list[FakeScene]) -> None:
    env, before, _ = played()
    physics[0].bulge_m = 1e-3
    after, *_ = env.step(np.zeros(4, dtype=np.float32))
    assert (before["depth_picture"] != after["depth_picture"]).any()


def test_pictures_follow_the_motion_of_the_peg() -> None:
    """The rig follows in y and z, so the base moves in the picture and the peg does not."""
    env, before, _ = played(observables=(SEGMENTATION,), options=LEFT | {"start": (0, 0, 0, 5, 1)})
    after, *_ = env.step(np.array([0, 1, 0, -1], dtype=np.float32))
    peg_before, peg_after = (seen["segmentation"] == Label.PEG for seen in (before, after))
    base_before, base_after = (seen["segmentation"] == Label.BASE for seen in (before, after))
    assert (peg_before != peg_after).sum() < 0.02 * peg_before.sum()
    assert (base_before != base_after).sum() > 100


def test_delayed_pictures_lie_between_two_env_steps() -> None:
    """With the whole delay they are those of the env step before; at the start there is nothing to be late for."""
    start, motion = LEFT | {"start": (0, 0, 0, 5, 1)}, [0.5, 1, 0, -1]
    _, first, _ = played(options=start)
    seen = {part: played(motion, options=start, picture_delay=part)[1]["depth_picture"] for part in (0.0, 0.5, 1.0)}
    assert np.allclose(seen[1.0], first["depth_picture"], atol=1e-6)
    changed = {part: (np.abs(picture - seen[0.0]) > 1e-4).sum() for part, picture in seen.items()}
    assert 0 == changed[0.0] < changed[0.5] < changed[1.0]
    _, late, _ = played(options=start, picture_delay=0.5)
    np.testing.assert_array_equal(late["depth_picture"], first["depth_picture"])


@pytest.mark.parametrize(
    ("moved", "at_m", "turn_rad"),
    [
        ({"camera_x_mm": 2.0}, [2e-3, 0, 0], 0.0),
        ({"camera_z_mm": -2.0}, [0, 0, -2e-3], 0.0),
        ({"camera_turn_deg": 0.2}, [0, 0, 0], np.radians(0.2)),
    ],
)
def test_the_rig_stands_where_its_settings_put_it(moved: dict[str, Any], at_m: list[float], turn_rad: float) -> None:
    nominal, found = (played(**settings)[0].task_scene.sight().pose for settings in (NOMINAL, moved))
    assert found.position_m - nominal.position_m == pytest.approx(at_m)
    axes = nominal.world_from_camera.T @ found.world_from_camera
    assert np.arccos(np.clip(axes[2, 2], -1.0, 1.0)) == pytest.approx(turn_rad, abs=1e-7)


def test_stereo_depth_is_the_default_and_differs_from_the_exact_one() -> None:
    _, exact, _ = played(depth_mode="gt")
    env, measured, _ = FusionInsertionEnv(), *FusionInsertionEnv().reset(options=LEFT)
    assert env.settings.depth_mode == "stereo"
    known = measured["depth_picture"] > 0
    assert 0.8 < known.sum() / (exact["depth_picture"] > 0).sum() < 1.0
    error_m = np.abs(measured["depth_picture"] - exact["depth_picture"])[known]
    assert 1e-4 < np.median(error_m) < 2e-3


def test_rng_seed_fixes_the_noise_of_depth_and_clouds() -> None:
    first, second, other = (FusionInsertionEnv().reset(options=LEFT | {"rng_seed": (0, seed)})[0] for seed in (1, 1, 2))
    for key in ("depth_picture", "object_point_cloud", "marker_flow"):
        np.testing.assert_array_equal(first[key], second[key])
        assert (first[key] != other[key]).any()


def test_a_peg_out_of_the_picture_gives_zeros_and_a_flag(
    physics: list[FakeScene], monkeypatch: pytest.MonkeyPatch
) -> None:
    env, *_ = played()
    away_m = physics[0].body_vertices_m(0) + 9.0
    monkeypatch.setattr(physics[0], "body_vertices_m", lambda _: away_m)
    observation, *_, info = env.step(np.zeros(4, dtype=np.float32))
    assert (info["peg_seen"], info["base_seen"]) == (False, True)
    assert (observation["object_point_cloud"][0] == 0).all()
    assert (observation["object_point_cloud"][1, :, 2] > 0).all()


def test_random_cameras_move_the_picture_and_nothing_else() -> None:
    _, nominal, info = played()
    _, shifted, shifted_info = played(random_camera_turn_rad=0.04, random_camera_offset_m=0.02)
    assert (nominal["rgb_picture"] != shifted["rgb_picture"]).any()
    np.testing.assert_array_equal(nominal["relative_motion"], shifted["relative_motion"])
    np.testing.assert_array_equal(info["gt_offset_mm_deg"], shifted_info["gt_offset_mm_deg"])


def test_info_keys_come_in_the_order_of_the_logs() -> None:
    *_, info = played([0.0] * 4)
    assert list(info)[:9] == [
        "steps",
        "surface_diff_m",
        "tactile_movement_too_large",
        "too_many_steps",
        "error_too_large",
        "peg_relative_z_mm",
        "is_success",
        "relative_motion_mm_deg",
        "gt_offset_mm_deg",
    ]
    assert info["steps"] == 1


def test_driving_away_from_the_right_hole_ends_the_episode() -> None:
    """The hexagon's start lies 22.6 mm from its hole; 30 mm are allowed."""
    away = [0.0, -1.0, 0.0, 0.0]
    *_, truncated, info = played(*[away] * 8, options=LEFT | {"start": (0, 0, 0, 5, 1)})
    assert (truncated, info["end_reason"]) == (True, "error")


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("depth_mode", "radar"),
        ("clearance_mm", 0.0),
        ("clearance_mm", 8.0),
        ("insertion_depth_mm", 13.0),
        ("random_z_mm", (9.0, 3.0)),
        ("random_camera_turn_rad", 0.5),
        ("action_scale_mm_deg", (1.0, 1.0, 1.0)),
    ],
)
def test_unusable_setting_is_refused_by_name(setting: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=f"Setting '{setting}' is"):
        FusionInsertionEnv(**{setting: value})


def test_mesh_hash_tells_other_clearances() -> None:
    assert FusionInsertionEnv().mesh_hash() != FusionInsertionEnv(clearance_mm=1.0).mesh_hash()


def test_only_the_chosen_keys_are_observed_in_the_order_of_the_task() -> None:
    env, observation, info = played(observation_keys=("marker_flow", "rgb_picture"))
    assert list(observation) == ["rgb_picture", "marker_flow"]
    assert observation in env.observation_space
    assert "peg_seen" not in info


@pytest.mark.parametrize("key", PUBLIC)
def test_what_a_key_holds_does_not_depend_on_the_other_keys(key: str) -> None:
    """Neither now nor after env steps; so choosing keys chooses no noise."""
    motion = [0.0, 0.0, 0.0, -0.1]
    _, everything, *_ = played(motion, motion, depth_mode="stereo")
    _, alone, *_ = played(motion, motion, depth_mode="stereo", observation_keys=(key,))
    assert list(alone) == [key]
    np.testing.assert_array_equal(everything[key], alone[key])


def test_pictures_that_are_not_observed_are_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("A picture was taken.")

    monkeypatch.setattr("vitac.envs.vision.camera.rasterize", refuse)
    played([0.0] * 4, observation_keys=("marker_flow", "relative_motion"))
    with pytest.raises(AssertionError, match="A picture was taken"):
        played(observation_keys=("rgb_picture",))


def test_noise_differs_between_env_steps() -> None:
    env, first, _ = played(depth_mode="stereo")
    second, *_ = env.step(np.zeros(4, dtype=np.float32))
    assert (first["depth_picture"] != second["depth_picture"]).any()


@pytest.mark.parametrize("key", ["infrared", "gt_offset"])
def test_unknown_and_privileged_keys_are_refused_with_the_list_of_valid_ones(key: str) -> None:
    with pytest.raises(UnknownObservationKey, match=f"no observation key '{key}'; expected {', '.join(PUBLIC)}"):
        FusionInsertionEnv(observation_keys=("marker_flow", key))


def test_random_physics_differs_between_episodes_and_stays_in_the_training_ranges(physics: list[FakeScene]) -> None:
    env = FusionInsertionEnv(random_physics=True, observation_keys=())
    drawn = set()
    for seed in range(30):
        env.reset(options=LEFT | {"rng_seed": (0, seed)})
        (peg, base), (gel, _) = physics[-1].bodies, physics[-1].gels
        assert 50 <= gel.friction <= 125
        assert 4 <= peg.friction <= 15
        assert 0 <= base.friction <= 1
        drawn.add((gel.friction, peg.friction, base.friction))
    assert len(drawn) == 30
    assert env.settings == FusionInsertionEnv(random_physics=True).settings


def test_random_physics_is_off_and_repeats_with_the_seed(physics: list[FakeScene]) -> None:
    for random_physics in (False, True, True):
        played(random_physics=random_physics, observation_keys=())
    official, first, second = ([body.friction for body in scene.bodies] for scene in physics)
    assert official == [9.5, 0.5]
    assert first == second != official


SEATED = InsertionState(
    env_steps=20,
    offset=FusionOffset(x_mm=0.5, y_mm=-0.5, theta_deg=1.0, z_mm=8.0),
    surface_diff_m=np.array([1e-4, 1e-4]),
    peg_relative_z_mm=np.array([-1.2, -1.1, -1.3, -1.2]),
)


def judged(state: InsertionState[FusionOffset]) -> Flags:
    return judge_flags(state, max_steps=50, insertion_depth_mm=1.0)


def moved(**offset: float) -> InsertionState[FusionOffset]:
    return replace(SEATED, offset=replace(SEATED.offset, **offset))


def test_a_peg_deep_in_the_right_hole_is_a_success() -> None:
    assert judged(SEATED) == Flags(is_success=True)


def test_every_corner_must_be_deep_enough() -> None:
    assert not judged(replace(SEATED, peg_relative_z_mm=np.array([-1.2, -0.99, -1.3, -1.2]))).is_success
    assert not judged(replace(SEATED, peg_relative_z_mm=np.array([-1.2, -1.0, -1.3, -1.2]))).is_success


@pytest.mark.parametrize("offset", [{"x_mm": 6.0}, {"x_mm": -6.0}, {"y_mm": 6.0}, {"y_mm": -6.0}, {"theta_deg": 10.0}])
def test_a_peg_deep_in_another_place_is_none(offset: dict[str, float]) -> None:
    assert judged(moved(**offset)) == Flags()
    assert judged(moved(**{name: 0.999 * value for name, value in offset.items()})).is_success


@pytest.mark.parametrize(
    ("offset", "limit"), [("x_mm", 12.0), ("y_mm", 30.0), ("theta_deg", 20.0), ("z_mm", 32.4), ("z_mm", 2.4)]
)
def test_an_offset_beyond_its_limit_is_an_error(offset: str, limit: float) -> None:
    outwards = 1e-3 if limit > 2.4 else -1e-3
    assert not judged(moved(**{offset: limit})).error_too_large
    flags = judged(moved(**{offset: limit + outwards}))
    assert flags.error_too_large
    assert not flags.is_success


def test_moved_surface_or_used_up_steps_prevent_success() -> None:
    tactile = judged(replace(SEATED, surface_diff_m=np.array([1e-4, 1.6e-3])))
    assert tactile == Flags(tactile_movement_too_large=True)
    assert judged(replace(SEATED, env_steps=50)) == Flags(too_many_steps=True)
    assert judged(replace(SEATED, env_steps=49)).is_success


ENV = FusionInsertionEnv()


def start(options: dict[str, Any], seed: int = 0, env: FusionInsertionEnv = ENV) -> FusionStart:
    return env.choose_start(options, np.random.default_rng(seed), env.settings)


def test_left_start_counts_from_the_hexagonal_hole() -> None:
    """As the 2025 code has it: [x, y + 22.625 - y_target, theta, z + 10.5]."""
    found = start({"start": (2.3, -4.1, -3.2, 8.8, 1)})
    assert found.target is Target.LEFT
    assert found.offset.as_array() == pytest.approx([2.3, -4.1 + 22.625 - 45.25, -3.2, 19.3])


def test_right_start_counts_from_the_rectangular_hole() -> None:
    found = start({"start": (-1.3, 2.1, 9.1, 7.9, 0)})
    assert found.target is Target.RIGHT
    assert found.offset.as_array() == pytest.approx([-1.3, 2.1 + 22.625, 9.1, 18.4])


def test_random_starts_fill_their_ranges_on_both_sides() -> None:
    found = [start({}, seed) for seed in range(300)]
    sides = [each.target is Target.LEFT for each in found]
    assert 0.4 < np.mean(sides) < 0.6
    world = np.array([each.offset.as_array() for each in found])
    world[:, 1] += [each.target.y_mm - 22.625 for each in found]
    world[:, 3] -= 10.5
    assert (world.min(axis=0) >= [-5, -5, -10, 3]).all()
    assert (world.max(axis=0) <= [5, 5, 10, 9]).all()
    assert (np.ptp(world, axis=0) > [9, 9, 18, 5]).all()


@pytest.mark.parametrize(
    "value",
    [
        (0, 0, 0, 5),
        (12.1, 0, 0, 5, 1),
        (0, 7.4, 0, 5, 1),
        (0, 0, 20.1, 5, 1),
        (0, 0, 0, -0.1, 1),
        (0, 0, 0, 22.0, 1),
        (0, 0, 0, 5, 2),
        (0, 0, 0, 5, 0.5),
        (0, 0, float("nan"), 5, 1),
        "left",
    ],
)
def test_unusable_start_is_refused_and_says_what_is_expected(value: Any) -> None:
    with pytest.raises(
        ResetOptionsError, match=r"'start' is .*expected \(x mm, y mm, theta deg, z mm, left 1 or right 0\)"
    ):
        start({"start": value})


def test_magnitude_is_the_norm_of_all_four() -> None:
    assert FusionOffset(x_mm=1.0, y_mm=-2.0, theta_deg=4.0, z_mm=2.0).magnitude() == 5.0


def test_directions_are_those_of_the_challenge() -> None:
    assert (Target.LEFT.direction, Target.RIGHT.direction) == (1.0, -1.0)


@pytest.mark.parametrize(("shape", "target"), [("hexagon", Target.LEFT), ("cuboid", Target.RIGHT)])
def test_one_shape_that_may_be_drawn_fixes_the_side_and_nothing_else(shape: str, target: Target) -> None:
    env = FusionInsertionEnv(shapes=[shape])
    found = [start({}, seed, env) for seed in range(8)]
    assert {each.target for each in found} == {target}
    assert [each.offset.x_mm for each in found] == [start({}, seed).offset.x_mm for seed in range(8)]
