"""ManiSkill environments as tasks, from the catalogue alone: this runs without ManiSkill."""

import pytest
from vitac.envs.maniskill.definition import MODES, ManiSkillTaskRejected, catalogue, find_definition, is_maniskill
from vitac.envs.tasks.definition import Family
from vitac.envs.tasks.settings import SettingsError

NAMED = (
    *("PickCube-v1", "PushCube-v1", "StackCube-v1", "PegInsertionSide-v1", "PlugCharger-v1"),
    *("LiftPegUpright-v1", "PullCube-v1", "PokeCube-v1", "RollBall-v1"),
)


@pytest.mark.parametrize("name", NAMED)
def test_the_tasks_of_the_challenge_are_in_the_catalogue_with_all_modes(name: str) -> None:
    for mode in MODES:
        task = find_definition(f"ManiSkill/{name}", {"obs_mode": mode})
        assert task.family is (Family.MANISKILL if mode == "state" else Family.MANISKILL_PICTURES)
        assert task.repeats
        assert task.pictures_repeat == (mode == "state")
        assert task.control_mode == "pd_ee_delta_pose"
        assert [row.name for row in task.actions] == ["x", "y", "z", "rx", "ry", "rz", "gripper"]
        assert len({row.name for row in task.observables}) == len(task.observables)
        assert not any(row.privileged for row in task.observables)


def test_no_environment_is_both_usable_and_refused_and_every_refusal_is_a_sentence() -> None:
    known = catalogue()
    assert not known.environments.keys() & known.refused.keys()
    assert set(known.made_with) == {"mani-skill", "sapien"}
    assert all(reason.endswith(".") and "\n" not in reason and len(reason) < 200 for reason in known.refused.values())
    for described in known.environments.values():
        assert described.control_modes
        assert all(size > 0 for size in (*described.control_modes.values(), *(size for _, size in described.state)))


def test_the_state_vector_is_one_key_whose_parts_are_named_with_their_places() -> None:
    (state,) = find_definition("ManiSkill/PickCube-v1", {}).observables
    assert (state.name, state.shape, state.dtype) == ("state", (42,), "float32")
    for part in ("0 to 8 agent_qpos", "9 to 17 agent_qvel", "18 extra_is_grasped", "19 to 25 extra_tcp_pose"):
        assert part in state.meaning
    assert state.meaning.endswith("39 to 41 extra_obj_to_goal_pos [m].")


@pytest.mark.parametrize(
    ("env_id", "parts"),
    [
        ("PickCube-v1", ("agent_qpos [rad; m of sliding joints]", "pose [position in m, quaternion wxyz]")),
        ("PegInsertionSide-v1", ("extra_peg_half_size [m]", "extra_box_hole_radius [m]")),
        ("RollBall-v1", ("extra_ball_vel [m/s]",)),
        ("TriFingerRotateCubeLevel0-v1", ("extra_obj_p [m]", "extra_goal_q [quaternion wxyz]", "tip_velocities,")),
        ("PickCube-v1", ("18 extra_is_grasped,",)),
    ],
)
def test_parts_of_the_state_have_the_unit_that_their_name_says_and_others_none(
    env_id: str, parts: tuple[str, ...]
) -> None:
    (state,) = find_definition(f"ManiSkill/{env_id}", {"control_mode": "pd_joint_delta_pos"}).observables
    for part in parts:
        assert part in state.meaning


def test_pictures_are_keys_of_their_own_and_show_no_true_pose() -> None:
    rgb = {row.name: row for row in find_definition("ManiSkill/PickCube-v1", {"obs_mode": "rgb"}).observables}
    assert (rgb["base_camera_rgb"].shape, rgb["base_camera_rgb"].dtype) == ((128, 128, 3), "uint8")
    assert "agent_qpos" in rgb
    assert not {"extra_obj_pose", "state", "base_camera_depth"} & set(rgb)
    assert "base_camera_depth" in {
        row.name for row in find_definition("ManiSkill/PickCube-v1", {"obs_mode": "rgbd"}).observables
    }
    assert "pointcloud_xyzw" in {
        row.name for row in find_definition("ManiSkill/PickCube-v1", {"obs_mode": "pointcloud"}).observables
    }


@pytest.mark.parametrize(
    ("control_mode", "names"),
    [
        ("pd_ee_delta_pos", ["x", "y", "z", "gripper"]),
        ("pd_ee_target_delta_pos", ["x", "y", "z", "gripper"]),
        ("pd_joint_delta_pos", [*(f"joint_{number}" for number in range(1, 8)), "gripper"]),
        ("pd_joint_vel", [f"action_{index}" for index in range(8)]),
    ],
)
def test_numbers_of_an_action_are_named_where_they_are_known(control_mode: str, names: list[str]) -> None:
    actions = find_definition("ManiSkill/PickCube-v1", {"control_mode": control_mode}).actions
    assert [row.name for row in actions] == names


@pytest.mark.parametrize(
    ("env_id", "settings", "message"),
    [
        ("ManiSkill/PickCub-v1", {}, "There is no ManiSkill/PickCub-v1; did you mean 'PickCube-v1'"),
        ("ManiSkill/TurnFaucet-v1", {}, "cannot be a task. It needs files that ManiSkill downloads: partnet_mob"),
        ("ManiSkill/PickSingleYCB-v1", {}, "cannot be a task. It needs files that ManiSkill downloads: ycb."),
        ("ManiSkill/AssemblingKits-v1", {}, "It needs files that ManiSkill downloads: assembling_kits."),
        ("ManiSkill/TwoRobotPickCube-v1", {}, "cannot be a task. It has several robots"),
        ("ManiSkill/PickCube-v1", {"obs_mode": "rgbx"}, "obs_mode is 'rgbx', expected one of state, rgb, rgbd, pointc"),
        ("ManiSkill/PickCube-v1", {"control_mode": "pd_joint_pos"}, "no control mode 'pd_joint_pos' with actions in"),
    ],
)
def test_what_cannot_be_a_task_is_refused_by_name(env_id: str, settings: dict[str, str], message: str) -> None:
    with pytest.raises(ManiSkillTaskRejected) as refused:
        find_definition(env_id, settings)
    assert message in str(refused.value)


def test_an_unknown_setting_names_the_nearest_one() -> None:
    with pytest.raises(SettingsError, match="Unknown setting 'obs_mod'; did you mean 'obs_mode'"):
        find_definition("ManiSkill/PickCube-v1", {"obs_mod": "rgb"})
    with pytest.raises(SettingsError, match="'success_key' is 1, expected a value of type str"):
        find_definition("ManiSkill/PickCube-v1", {"success_key": 1})


def test_only_ids_with_the_prefix_are_maniskills() -> None:
    assert is_maniskill("ManiSkill/PickCube-v1")
    assert not is_maniskill("ViTac/PegInsertion-v1")


def test_physics_on_a_gpu_is_a_family_of_its_own_that_does_not_repeat() -> None:
    for mode in MODES:
        task = find_definition("ManiSkill/PickCube-v1", {"obs_mode": mode, "sim_backend": "physx_cuda"})
        assert (task.family, task.repeats) == (Family.MANISKILL_CUDA, False)
    with pytest.raises(ManiSkillTaskRejected, match="sim_backend is 'cuda:0', expected physx_cpu or physx_cuda"):
        find_definition("ManiSkill/PickCube-v1", {"sim_backend": "cuda:0"})


def test_several_scenes_at_once_are_for_a_gpu_alone_and_no_more_than_policies_can_be_loaded() -> None:
    on_gpu = {"sim_backend": "physx_cuda"}
    sizes = [
        find_definition("ManiSkill/PickCube-v1", settings).batch_size
        for settings in ({}, {"batch_size": 1}, on_gpu, on_gpu | {"batch_size": 16}, on_gpu | {"batch_size": 64})
    ]
    assert sizes == [1, 1, 1, 16, 64]
    for settings, expected in (
        ({"batch_size": 2}, "batch_size is 2, expected 1: only physx_cuda moves several scenes at once"),
        (on_gpu | {"batch_size": 65}, "batch_size is 65, expected 1 to 64"),
        (on_gpu | {"batch_size": 0}, "batch_size is 0, expected 1 to 64"),
    ):
        with pytest.raises(ManiSkillTaskRejected, match=expected):
            find_definition("ManiSkill/PickCube-v1", settings)
    with pytest.raises(SettingsError, match="'batch_size' is '4', expected a value of type int"):
        find_definition("ManiSkill/PickCube-v1", on_gpu | {"batch_size": "4"})
