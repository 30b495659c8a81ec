import gzip
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from unpacked_files import Unpacked, unpack
from vitac.envs.drawing.drawable import NotDrawable, straight_to_target
from vitac.envs.drawing.playback import EpisodePlayback, Pace, record
from vitac.envs.fem.contact.forces import PairForces, no_forces
from vitac.envs.playback_files import scene
from vitac.envs.playback_files.scene import (
    PLACES,
    SCENE_BYTES,
    Changes,
    PlaybackTooLarge,
    make_arrows,
    pack,
    pack_scene,
    whole_numbers,
)
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv


@pytest.fixture
def peg_file(peg_playback: EpisodePlayback) -> Unpacked:
    return unpack(pack_scene(peg_playback))


def test_a_usual_episode_is_a_small_part_of_what_is_possible(peg_playback: EpisodePlayback) -> None:
    assert len(pack_scene(peg_playback)) < SCENE_BYTES / 5


def test_every_ipc_step_is_in_the_file(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    steps = peg_file.arrays["moment_env_steps"]
    assert steps.tolist() == [moment.env_step for moment in peg_playback.moments]
    for name in ("sensor_poses", "displacements", "pressures", "held_poses"):
        assert len(peg_file.arrays[name]) == len(steps), name


def test_gels_are_where_they_were_to_a_hundredth_of_a_millimetre(
    peg_playback: EpisodePlayback, peg_file: Unpacked
) -> None:
    arrays = peg_file.arrays
    unit_mm = peg_file.header["displacement_unit_mm"]
    for index in (0, 3, -1):
        moment = peg_playback.moments[index]
        for side in (0, 1):
            pose = arrays["sensor_poses"][index, side].astype(float)
            local_mm = arrays["gel_nodes_mm"] + unit_mm * arrays["displacements"][index, side]
            world_mm = local_mm @ pose[:9].reshape(3, 3).T + pose[9:]
            np.testing.assert_allclose(world_mm, 1e3 * moment.gel_nodes_m[side], atol=1e-2)


def test_the_held_part_is_where_it_was(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    for index in (0, -1):
        pose = peg_file.arrays["held_poses"][index].astype(float)
        world_mm = peg_file.arrays["held_vertices_mm"] @ pose[:9].reshape(3, 3).T + pose[9:]
        np.testing.assert_allclose(world_mm, 1e3 * peg_playback.moments[index].held_m, atol=1e-2)


def test_a_soft_part_is_where_it_was_and_a_rigid_one_has_no_motion_of_its_own(
    peg_playback: EpisodePlayback, peg_file: Unpacked
) -> None:
    assert "held_displacements" not in peg_file.arrays
    first, *others = peg_playback.moments
    bent_m = first.held_m + 2e-3 * np.square(first.held_m[:, [2, 0, 1]] / 0.05)
    bent = replace(peg_playback, moments=(replace(first, held_m=bent_m), *others))
    file = unpack(pack_scene(bent))
    own_mm = file.arrays["held_vertices_mm"] + file.header["displacement_unit_mm"] * file.arrays["held_displacements"]
    for index, moment in ((0, bent.moments[0]), (-1, bent.moments[-1])):
        pose = file.arrays["held_poses"][index].astype(float)
        world_mm = own_mm[index] @ pose[:9].reshape(3, 3).T + pose[9:]
        np.testing.assert_allclose(world_mm, 1e3 * moment.held_m, atol=2e-2)


def test_the_fixed_part_does_not_move(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    np.testing.assert_allclose(peg_file.arrays["fixed_vertices_mm"], 1e3 * peg_playback.fixed_m, atol=1e-4)
    assert peg_file.arrays["fixed_triangles"].max() < len(peg_playback.fixed_m)


def test_lost_markers_are_beside_the_flow_and_none_of_it(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    lost = peg_file.arrays["lost_markers"]
    unit_px = peg_file.header["flow_unit_px"]
    ends = [peg_playback.moments[index] for index in peg_playback.last_moments]
    found = 0
    for step, moment in enumerate(ends):
        for side in (0, 1):
            shown_px = unit_px * lost[step, side][lost[step, side, :, 0] > np.iinfo(np.int16).min]
            np.testing.assert_allclose(shown_px, moment.lost_px[side], atol=1 / 128)
            apart_px = np.linalg.norm(shown_px[:, None] - moment.marker_flow[side, 1], axis=2)
            assert (apart_px > 5).all()
            found += len(shown_px)
    assert found > 0


def test_marker_flow_has_a_sixty_fourth_of_a_pixel(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    ends = [peg_playback.moments[index] for index in peg_playback.last_moments]
    unit_px = peg_file.header["flow_unit_px"]
    for name, which in (("flow_references", 0), ("flow_positions", 1)):
        flows = np.stack([moment.marker_flow[:, which] for moment in ends])
        np.testing.assert_allclose(unit_px * peg_file.arrays[name], flows, atol=1 / 128)


def test_what_is_plotted_has_one_value_for_each_env_step(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    arrays, played = peg_file.arrays, len(peg_playback.rewards)
    assert arrays["action_values"].shape == (played, 3)
    np.testing.assert_allclose(arrays["rewards"], peg_playback.rewards, atol=0.006)
    assert arrays["surface_motions_mm"].shape == (played + 1, 2)
    assert arrays["heights_mm"].shape[0] == played + 1
    assert [action["unit"] for action in peg_file.header["actions"]] == ["mm", "mm", "degree"]
    assert peg_file.header["end_reason"] == "success"


def test_pressed_gels_have_a_contact_pressure(peg_file: Unpacked) -> None:
    pressures = peg_file.arrays["pressures"]
    assert pressures.max() == 255
    assert peg_file.header["pressure_unit_kpa"] > 0
    assert len(peg_file.arrays["sensing_nodes"]) == pressures.shape[2]


def test_moments_between_env_steps_are_left_out_until_the_file_is_small_enough(peg_playback: EpisodePlayback) -> None:
    whole = len(pack_scene(peg_playback))
    found = unpack(pack_scene(peg_playback, at_most=whole - 1)).arrays
    assert len(found["moment_env_steps"]) < len(peg_playback.moments)
    assert found["moment_env_steps"][-1] == peg_playback.moments[-1].env_step
    assert set(found["moment_env_steps"].tolist()) == {moment.env_step for moment in peg_playback.moments}


def test_an_episode_that_cannot_be_made_small_is_refused(peg_playback: EpisodePlayback) -> None:
    with pytest.raises(PlaybackTooLarge, match="at most 100 bytes, got"):
        pack_scene(peg_playback, at_most=100)


def test_an_episode_that_ended_at_its_start_has_one_moment(peg_playback: EpisodePlayback) -> None:
    first = replace(
        peg_playback,
        moments=peg_playback.moments[:1],
        actions=peg_playback.actions[:0],
        rewards=peg_playback.rewards[:0],
    )
    found = unpack(pack_scene(first))
    assert found.arrays["action_values"].shape == (0, 3)
    assert found.arrays["moment_env_steps"].tolist() == [0]


def test_a_task_that_is_not_drawn_is_played_all_the_same(
    peg_playback: EpisodePlayback, monkeypatch: pytest.MonkeyPatch
) -> None:
    def undrawn(env_id: str) -> None:
        raise NotDrawable(env_id)

    monkeypatch.setattr(scene, "find_perspective", undrawn)
    found = unpack(pack_scene(peg_playback))
    assert found.header["held_name"] == "held part"
    assert "heights_mm" not in found.arrays


def test_nobody_reads_exact_actions_out_of_the_file(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    """Neither where they are plotted, nor from where the gripper was before and after."""
    shown = peg_file.arrays["action_values"].astype(float)
    np.testing.assert_array_equal(shown, peg_playback.actions.round(2).astype(np.float32))
    places_mm = peg_file.arrays["sensor_poses"][..., 9:].astype(float)
    np.testing.assert_allclose(places_mm, places_mm.round(2), atol=1e-5)
    rotations = peg_file.arrays["sensor_poses"][..., :9].astype(float)
    np.testing.assert_allclose(rotations, rotations.round(4), atol=1e-6)


def test_arrows_of_the_gels_are_as_large_as_their_forces(peg_playback: EpisodePlayback, peg_file: Unpacked) -> None:
    forces_n, arrows_n = peg_file.arrays["forces_n"], peg_file.arrays["arrow_forces_n"]
    assert len(forces_n) == len(arrows_n) == len(peg_playback.moments)
    np.testing.assert_allclose(np.linalg.norm(arrows_n[:, :2], axis=2), forces_n[:, 1:], atol=0.05)
    assert forces_n[:, 1:].min() == 5
    assert not arrows_n[:, 2:].any()  # this peg touches nothing
    assert peg_file.header["force_limit_n"] is None


LEFT, HELD, FIXED = 0, 2, 3


def found(*pairs: tuple[int, int, tuple[float, float, float], tuple[float, float, float]]) -> PairForces:
    return no_forces()._replace(
        bodies=np.array([pair[:2] for pair in pairs]),
        points_m=np.array([pair[2] for pair in pairs]) * 1e-3,
        forces_n=np.array([pair[3] for pair in pairs]),
    )


def test_an_arrow_of_a_gel_adds_up_its_contacts_whichever_body_comes_first() -> None:
    places_m, forces_n = make_arrows(found((HELD, LEFT, (0, 0, 0), (3, 0, 0)), (LEFT, HELD, (4, 0, 0), (-1, 0, 0))))
    assert forces_n[0].tolist() == [4, 0, 0]
    np.testing.assert_allclose(places_m[0], [1e-3, 0, 0])
    assert not forces_n[1:].any()


def test_contacts_with_the_fixed_part_are_one_arrow_for_each_place() -> None:
    near, far = (0, 0, 0), (10, 0, 0)
    _, forces_n = make_arrows(
        found((HELD, FIXED, near, (0, 0, 1)), (HELD, FIXED, far, (0, 0, 5)), (HELD, FIXED, (0, 1, 0), (0, 0, 2)))
    )
    assert forces_n[2:4].tolist() == [[0, 0, 5], [0, 0, 3]]


def test_nothing_that_touches_is_no_arrow_and_many_places_are_the_strongest() -> None:
    assert not make_arrows(no_forces())[1].any()
    row = [(HELD, FIXED, (5.0 * at, 0.0, 0.0), (0.0, 0.0, float(at))) for at in range(1, 10)]
    assert make_arrows(found(*row))[1][2:, 2].tolist() == [9, 8, 7, 6, 5, 4][:PLACES]


@pytest.mark.usefixtures("fake_scenes")
def test_curves_of_observables_have_one_value_for_each_env_step() -> None:
    env = PegInsertionEnv(optional_observables=("wrist_wrench", "joint_width"))
    playback = record(env, options={"rng_seed": (0, 5)}, next_action=straight_to_target(env.env_id), pace=Pace.IPC_STEP)
    file = unpack(pack_scene(playback))
    assert file.header["curves"] == [
        {"title": "Joint width [mm]", "names": ["width"]},
        {"title": "Wrist force [N]", "names": ["x", "y", "z"]},
        {"title": "Wrist moment [N m]", "names": ["x", "y", "z"]},
    ]
    wrenches = np.array([playback.moments[index].info["wrist_wrench"] for index in playback.last_moments])
    assert len(wrenches) == len(playback.rewards) + 1 > 2
    np.testing.assert_allclose(file.arrays["curves_1"], wrenches[:, :3], atol=6e-4)
    np.testing.assert_allclose(file.arrays["curves_2"], wrenches[:, 3:], atol=6e-4)


def test_header_and_arrays_come_back() -> None:
    given_arrays: dict[str, NDArray[Any] | Changes] = {
        "bytes": np.arange(5, dtype=np.uint8),
        "heights": np.array([[1.5, -2.25]], dtype=np.float32),
        "indices": np.array([[0, 65535, 7]], dtype=np.uint16),
        "nothing": np.zeros((0, 3), dtype=np.float32),
    }
    found = unpack(pack({"name": "Höhe", "goal": -1.5}, given_arrays))
    assert found.header["name"] == "Höhe"
    assert found.header["goal"] == -1.5
    for name, array in given_arrays.items():
        assert isinstance(array, np.ndarray)
        assert found.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(found.arrays[name], array)


@given(
    arrays.arrays(st.sampled_from([np.int16, np.uint8]), st.tuples(st.integers(1, 6), st.integers(1, 3)), elements=None)
)
def test_changes_add_up_to_the_values_even_where_they_wrap_around(values: np.ndarray) -> None:
    found = unpack(pack({}, {"first": np.zeros(1, np.uint8), "values": Changes(values=values)}))
    np.testing.assert_array_equal(found.arrays["values"], values)


def test_the_same_content_makes_the_same_file() -> None:
    array = np.arange(100, dtype=np.int16)
    assert pack({"a": 1}, {"x": array}) == pack({"a": 1}, {"x": array})


def test_slow_motion_takes_less_room_as_changes() -> None:
    steps = np.cumsum(np.random.default_rng(1).integers(-2, 3, (40, 200)), axis=0).astype(np.int16)
    assert len(pack({}, {"x": Changes(values=steps)})) < 0.7 * len(pack({}, {"x": steps}))


def test_a_file_is_gzip_that_a_browser_unpacks_by_itself() -> None:
    assert gzip.decompress(pack({}, {})).startswith(b"VITACPB1")


def test_a_header_holds_no_number_that_json_lacks() -> None:
    with pytest.raises(ValueError, match="JSON"):
        pack({"goal": float("nan")}, {})


def test_whole_numbers_are_rounded_and_end_at_the_range_of_their_type() -> None:
    values = whole_numbers([-40.0, -0.0014, 0.0016, 40.0], 0.001, np.int16)
    assert values.tolist() == [-32768, -1, 2, 32767]
    assert values.dtype == np.int16
