"""Tasks whose environment is ManiSkill's, as a track file of an organizer has them."""

from pathlib import Path

import pytest
from cubes_track import FILE
from vitac.envs.maniskill.env import ManiSkillMissing, missing_packages
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.strict_model import DocumentRejected, parse_yaml
from vitac.evaluator.tracks import Track, load_track
from vitac.evaluator.tracks.definition import UnknownEnvironment, environment_definition
from vitac.evaluator.tracks.sealed import sealed_track


def track(**replaced: str) -> Track:
    content = FILE
    for old, new in replaced.items():
        assert old in content
        content = content.replace(old, new)
    return parse_yaml(Track, content, "cubes.yaml")


def test_a_track_file_alone_makes_a_task() -> None:
    task = track().tasks["pick-cube"]
    assert task.definition.family is Family.MANISKILL
    assert [row.name for row in task.actions] == ["x", "y", "z", "gripper"]
    assert [(row.name, row.shape) for row in task.observables] == [("state", (42,))]
    assert [episode.number for episode in task.episodes] == list(range(1, 21))
    assert len({str(episode.options["rng_seed"]) for episode in task.episodes}) == 20


def test_the_digest_changes_with_the_modes() -> None:
    digests = {
        track().tasks["pick-cube"].digest(),
        track(obs_mode="success_key: success, obs_mode").tasks["pick-cube"].digest(),
        track(pd_ee_delta_pos="pd_ee_target_delta_pos").tasks["pick-cube"].digest(),
        track(**{"obs_mode: state": "obs_mode: rgb"}).tasks["pick-cube"].digest(),
    }
    assert len(digests) == 4


def test_a_sealed_list_has_other_seeds() -> None:
    sealed = sealed_track(track(), bytes(32)).tasks["pick-cube"]
    public = track().tasks["pick-cube"]
    assert sealed.episode_list.list_seed != public.episode_list.list_seed
    assert len(sealed.episodes) == len(public.episodes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("PickCube-v1", "PickCubes-v1", r"did you mean 'PickCube-v1'\?$"),
        ("PickCube-v1", "TurnFaucet-v1", r"cannot be a task\. It needs files that ManiSkill downloads"),
        ("pd_ee_delta_pos", "pd_ee_pos", r"no control mode 'pd_ee_pos'"),
        ("obs_mode: state", "obs_mode: sensors", r"obs_mode is 'sensors', expected one of state, rgb"),
        ("obs_mode: state", "observe: state", r"Unknown setting 'observe'"),
        ("obs_mode: state", "batch_size: 4", r"batch_size is 4, expected 1: only physx_cuda"),
        ("obs_mode: state", "sim_backend: physx_cuda, batch_size: 16", r"shard_size is 10, expected at least batch_s"),
        ("ManiSkill/PickCube-v1", "Other/PickCube-v1", r"env_id is 'Other/PickCube-v1', expected one of ViTac/Ass"),
    ],
)
def test_a_file_that_cannot_be_played_is_refused_when_it_is_read(old: str, new: str, message: str) -> None:
    with pytest.raises(DocumentRejected, match=message):
        track(**{old: new})


def test_our_own_tasks_have_the_definition_of_their_folder() -> None:
    task = load_track("track_1").tasks["peg-insertion"]
    assert task.definition.family is Family.TACTILE
    assert environment_definition(task.env_id, {}) is task.definition
    with pytest.raises(UnknownEnvironment, match="env_id is 'ViTac/Peg-v1', expected one of"):
        environment_definition("ViTac/Peg-v1", {})


def test_its_environment_is_made_by_the_adapter_or_refused_with_what_to_install(tmp_path: Path) -> None:
    task = track().tasks["pick-cube"]
    if missing_packages():
        with pytest.raises(ManiSkillMissing, match="extra maniskill, 3 GB"):
            make_environment(task, tmp_path)
        return
    env = make_environment(task, tmp_path, ())
    observation, info = env.reset(options=task.episodes[0].options)
    assert (dict(observation), info["end_reason"]) == ({}, None)
