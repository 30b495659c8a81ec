"""The soft plug and the cable's end on a stand-in for the physics, where they move with the gripper and never bend."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from unpacked_files import unpack
from vitac.envs.drawing.playback import record
from vitac.envs.playback_files.scene import pack_scene
from vitac.envs.tactile.gel import arena_gel_mesh
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError
from vitac.envs.tasks.soft_plug.env import (
    FORMS,
    START_GAP_MM,
    CableEndEnv,
    CableShape,
    PlugShape,
    SoftPlugEnv,
    SoftPlugScene,
    plate_mesh,
    plug_mesh,
    stiffening,
    touch_then_push,
)

START = {"shape": "slim", "offset_mm": (2.0, -1.0), "rng_seed": (0, 1)}
DOWN = (0.0, 0.0, -1.0)


def played(*actions: tuple[float, float, float], start: dict[str, Any] = START, **settings: Any) -> tuple[Any, ...]:
    env = SoftPlugEnv(**settings)
    result: tuple[Any, ...] = env.reset(options=start)
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


@pytest.mark.parametrize("shape", list(PlugShape))
def test_plug_is_free_and_has_rounded_corners(shape: PlugShape) -> None:
    mesh = plug_mesh(shape)
    half_mm = 0.5 * FORMS[shape].width_mm
    lower_mm = 1e3 * mesh.rest_position_m[mesh.rest_position_m[:, 2] == 0.0]
    assert mesh.is_free
    assert np.ptp(1e3 * mesh.rest_position_m, axis=0) == pytest.approx([2 * half_mm, 2 * half_mm, 38.0], rel=0.03)
    assert np.hypot(*lower_mm[:, :2].T).max() == pytest.approx(half_mm * np.sqrt(2 * 0.75))


def test_cable_has_a_hard_connector_and_a_boot_with_a_slim_neck() -> None:
    mesh = plug_mesh(CableShape.CABLE)
    rest_mm, factors = 1e3 * mesh.rest_position_m, stiffening(CableShape.CABLE, mesh)
    assert factors is not None
    hard_mm, soft_mm = rest_mm[mesh.hexahedra[factors > 1.0]], rest_mm[mesh.hexahedra[factors == 1.0]]
    assert hard_mm[..., 2].max() == pytest.approx(8.0) == soft_mm[..., 2].min()
    widths_mm = {z: np.ptp(rest_mm[rest_mm[:, 2] == z, 0]) / 8.5 for z in np.unique(rest_mm[:, 2])}
    neck = [width / widths_mm[0.0] for z, width in widths_mm.items() if 7.9 < z < 20.1]
    assert neck == pytest.approx([3.0 / 8.5] * 13)
    assert widths_mm[0.0] == pytest.approx(1.0, rel=0.02) == widths_mm[max(widths_mm)]
    assert stiffening(PlugShape.SLIM, plug_mesh(PlugShape.SLIM)) is None


def test_no_level_of_a_plug_is_held_at_the_height_of_a_row_of_the_gels_nodes() -> None:
    rows_mm = np.unique(1e3 * arena_gel_mesh().rest_position_m[arena_gel_mesh().sensing, 0].round(6))
    for shape, form in FORMS.items():
        levels_mm = np.unique(1e3 * plug_mesh(shape).rest_position_m[:, 2].round(6)) - form.grasp_mm
        assert np.abs(levels_mm[:, None] - rows_mm).min() > 0.3


@pytest.mark.parametrize("interference_mm", [-0.2, 0.0, 0.15])
def test_hole_is_narrower_than_the_plug_and_has_a_wider_mouth(interference_mm: float) -> None:
    vertices_mm = 1e3 * plate_mesh(PlugShape.STOPPER, interference_mm).vertices_m
    inner = vertices_mm[np.abs(vertices_mm[:, 0]) < 20.0]
    reach_mm = {round(float(z), 6): float(np.abs(inner[inner[:, 2] == z, :2]).max()) for z in np.unique(inner[:, 2])}
    narrow_mm = 5.0 - interference_mm
    assert reach_mm == pytest.approx({0.0: 6.0, -2.0: narrow_mm, -10.0: narrow_mm})


def test_action_moves_the_gripper_along_three_axes() -> None:
    _, observation, _, _, _, info = played((0.5, -1.0, 0.2), (-2.0, 0.0, 0.1))
    assert observation["relative_motion"] == pytest.approx([-0.5, -1.0, 0.3])
    assert info["gt_offset_mm"] == pytest.approx([1.5, -2.0])
    assert info["heights_mm"] == pytest.approx(np.full(4, 0.6 + 0.3))


def test_plug_has_the_stiffness_that_was_drawn(physics: list[FakeScene]) -> None:
    env = SoftPlugEnv(draws={"plug_modulus_mpa": (1.0, 2.0), "interference_mm": (0.05, 0.15)})
    moduli = set()
    for seed in range(3):
        env.reset(seed=seed)
        assert 1e6 <= physics[-1].gels[2].youngs_modulus_pa <= 2e6
        moduli.add(physics[-1].gels[2].youngs_modulus_pa)
    assert len(moduli) == 3


def test_success_is_all_of_the_lower_face_deep_in_the_hole() -> None:
    over = START | {"offset_mm": (0.0, 0.0)}
    *_, info = played(*[DOWN] * 4, start=over)
    assert (info["end_reason"], info["heights_mm"].max()) == (None, pytest.approx(-3.4))
    _, _, reward, terminated, truncated, info = played(*[DOWN] * 5, start=over)
    assert (terminated, truncated, info["end_reason"]) == (True, False, "success")
    assert reward == pytest.approx(0.6 + 10.0 - 0.1)


@pytest.mark.parametrize("bend_mm", [1.4, 1.6])
def test_a_plug_whose_end_is_aside_has_buckled(monkeypatch: pytest.MonkeyPatch, bend_mm: float) -> None:
    monkeypatch.setattr(SoftPlugScene, "bend_mm", lambda _: bend_mm)
    _, _, reward, _, truncated, info = played(DOWN)
    assert (info["end_reason"], truncated) == (("error", True) if bend_mm > 1.5 else (None, False))
    assert (reward < -9.0) == truncated
    assert info["largest_bend_mm"] == bend_mm


def test_a_boot_is_bent_where_its_neck_is_aside_though_the_connector_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    env = CableEndEnv()
    env.reset(options={"offset_mm": (2.0, -1.0)})
    scene, straight_m, rest_m = env.task_scene, env.scene.held_vertices_m, env.scene.held_surface.vertices_m
    aside_m = np.where(np.isclose(rest_m[:, 2], 14e-3), 2.4e-3, 0.0)[:, None] * np.array([1.0, 0.0, 0.0])
    monkeypatch.setattr(env.scene, "held_vertices_m", lambda vertices: straight_m(vertices) + aside_m[vertices])
    assert scene.lower_end_mm()[:2] == pytest.approx(scene.offset_mm())
    assert scene.bend_mm() == pytest.approx(2.4)
    *_, info = env.step(np.zeros(3, dtype=np.float32))
    assert info["end_reason"] == "error"


def test_a_gripper_that_has_left_the_hole_and_one_that_ran_out_of_time_have_failed() -> None:
    far = START | {"offset_mm": (7.5, 0.0)}
    assert played((1.0, 0.0, 0.0), start=far)[-1]["end_reason"] == "error"
    assert played(*[(0.0, 0.0, 0.0)] * 2, max_steps=2)[-1]["end_reason"] == "steps"


def test_starts_that_are_drawn_are_beside_the_hole_and_of_both_plugs() -> None:
    env = SoftPlugEnv()
    shapes, largest_mm = Counter[str](), 0.0
    for seed in range(30):
        _, info = env.reset(seed=seed)
        aside_mm = float(np.abs(info["gt_offset_mm"]).max())
        assert 1.2 <= aside_mm <= 3.0
        largest_mm = max(largest_mm, aside_mm)
        shapes[str(env.task_scene.shape)] += 1
    assert largest_mm > 2.5
    assert min(shapes[shape] for shape in PlugShape) > 5


def test_expert_presses_beside_the_hole_then_goes_over_it_before_it_pushes() -> None:
    env, observation, info = played()
    places_mm = []
    while info["end_reason"] is None:
        observation, *_, info = env.step(touch_then_push(observation, info))
        if np.abs(info["gt_offset_mm"]).max() > 0.2:
            places_mm.append(info["relative_motion_mm"])
    assert info["end_reason"] == "success"
    pressed, *over = places_mm[1:]
    np.testing.assert_allclose(pressed, [0.0, 0.0, -1.4], atol=1e-9)
    assert min(place[2] for place in over) > -START_GAP_MM


@pytest.mark.parametrize("option", [{"shape": "cork"}, {"offset_mm": (9.0, 0.0)}, {"offset_mm": (1.0,)}])
def test_options_that_are_no_start_are_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ResetOptionsError, match=f"ViTac/SoftPlug-v1: option '{next(iter(option))}'"):
        SoftPlugEnv().reset(options=option)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_steps", 0),
        ("ipc_steps", 0),
        ("action_scale_mm", (1.0, 1.0)),
        ("indentation_mm", 0.0),
        ("plug_modulus_mpa", 0.1),
        ("interference_mm", 1.0),
        ("largest_bend_mm", 0.0),
        ("random_xy_mm", 1.0),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=name):
        SoftPlugEnv(**{name: value})


def test_playback_has_the_plugs_own_surface() -> None:
    playback = record(SoftPlugEnv(max_steps=2), options=START, next_action=lambda *_: np.zeros(3, dtype=np.float32))
    file = unpack(pack_scene(playback))
    assert (file.header["held_name"], file.header["fixed_name"]) == ("plug", "plate")
    assert len(file.arrays["held_vertices_mm"]) == len(plug_mesh(PlugShape.SLIM).surface_nodes)


def test_cable_end_is_a_task_of_its_own_with_its_own_shape_and_hole() -> None:
    env = CableEndEnv()
    _, info = env.reset(seed=0)
    assert (env.env_id, env.task_scene.shape) == ("ViTac/CableEnd-v1", "cable")
    assert info["heights_mm"] == pytest.approx(np.full(4, 0.6))
    vertices_mm = 1e3 * plate_mesh(CableShape.CABLE, env.settings.interference_mm).vertices_m
    assert np.abs(vertices_mm[vertices_mm[:, 2] == -2.0]).max() == pytest.approx(4.45)
    with pytest.raises(ResetOptionsError, match="ViTac/CableEnd-v1: option 'shape'"):
        env.reset(options={"shape": "slim"})
