from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cubes_track import FILE
from vitac.errors import VitacError
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.tracks import ListKind, load_track
from vitac.server.competitions import own_tracks
from vitac.server.competitions.own_tracks import CheckedTrack, check_track

OFFSETS = [[-3.0, 2.0, 5.0], [1.0, -4.0, -8.0]]


def content(**task: Any) -> dict[str, Any]:
    """A track of one's own: six episodes of the peg task, two shards."""
    listed = {
        "list_seed": 5,
        "offset_option": "offset_mm_deg",
        "blocks": [{"repeats": 1, "shapes": ["cuboid", "trapezoid", "concave1"], "offsets": OFFSETS}],
    }
    own: dict[str, Any] = {
        "name": "short-peg",
        "env_id": "ViTac/PegInsertion-v1",
        "title": "Peg",
        "description": "A few pegs.",
        "success_rule": "As in track 1.",
        "max_steps": 8,
        "shard_size": 3,
        "episode_list": listed,
    }
    return {
        "name": "mine",
        "folder": "Mine",
        "title": "My track",
        "summary": "Short.",
        "accepts": ["model"],
        "tasks": {"short-peg": own | task},
    }


def checked(folder: Path, track: dict[str, Any], name: str = "mine.yaml") -> CheckedTrack:
    path = folder / name
    path.write_text(yaml.safe_dump(track))
    return check_track(path)


def test_a_good_file_tells_its_cost(tmp_path: Path) -> None:
    found = checked(tmp_path, content())
    (task,) = found.tasks
    assert (found.name, task.episodes, task.shards, task.list_kind) == ("mine", 6, 2, ListKind.PUBLIC)
    assert task.shapes == ("cuboid", "trapezoid", "concave1")
    assert 3 <= task.played <= 6, "every shape, and the ends of the offsets' ranges"
    assert task.cpu_s_per_episode is not None
    assert task.cpu_s is not None
    assert task.wall_s is not None
    assert task.cpu_s == pytest.approx(6 * task.cpu_s_per_episode)
    assert task.wall_s == pytest.approx(task.cpu_s / 2)


class Clocked:
    """An environment by whose work a clock goes: a reset takes 10 s, a motion 2 s, rest 1 s; motion fails at once."""

    def __init__(self) -> None:
        self.ends_after = 8
        self.now_s = 0.0
        self.n_steps = 0

    def reset(self, **_options: object) -> None:
        self.now_s, self.n_steps = self.now_s + 10, 0

    def step(self, action: np.ndarray[Any, Any]) -> tuple[None, float, bool, bool, dict[str, Any]]:
        self.n_steps += 1
        moves = bool(np.abs(action).max() > 0)
        self.now_s += 2 if moves else 1
        return None, 0.0, moves and self.n_steps == 3, self.n_steps == self.ends_after, {}


def test_the_cost_is_that_of_motions_up_to_the_last_env_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Policies move; at rest, and where failures end episodes early, an episode costs less than it may."""
    env = Clocked()
    monkeypatch.setattr(own_tracks, "make_environment", lambda *_: env)
    monkeypatch.setattr(own_tracks, "process_time", lambda: env.now_s)
    (task,) = checked(tmp_path, content(max_steps=8)).tasks
    assert task.cpu_s_per_episode == pytest.approx(10 + 8 * 2)
    env.ends_after = 9
    with pytest.raises(DocumentRejected, match="does not end within max_steps = 8"):
        checked(tmp_path, content(max_steps=8))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"settings": {"peg_frictoin": 1.0}}, "peg_friction"),
        ({"settings": {"z_step_mm": 9.0}}, "z_step_mm"),
        ({"max_steps": 2}, "does not end within max_steps = 2"),
        ({"env_id": "ViTac/Nothing-v1"}, "Nothing"),
        ({"title_": "x"}, "did you mean 'title'"),
    ],
)
def test_what_is_wrong_in_a_task_is_named(tmp_path: Path, change: dict[str, Any], reason: str) -> None:
    with pytest.raises(DocumentRejected, match=reason):
        checked(tmp_path, content(**change))


@pytest.mark.parametrize("start", [{"shape": "cube", "offset": OFFSETS[0]}, {"shape": "cuboid", "offset": [99, 0, 0]}])
def test_a_start_that_the_environment_refuses_is_named(tmp_path: Path, start: dict[str, Any]) -> None:
    listed = content()["tasks"]["short-peg"]["episode_list"] | {"blocks": [{"starts": [start]}]}
    with pytest.raises(VitacError, match=r"tasks\.short-peg: .*expected"):
        checked(tmp_path, content(episode_list=listed))


def test_all_that_is_wrong_in_a_track_is_told_at_once(tmp_path: Path) -> None:
    track = content(name="peg-insertion")
    track["tasks"] = {"peg-insertion": track["tasks"]["short-peg"]}
    track["accepts"] = ["model", "text_log"]
    with pytest.raises(DocumentRejected) as caught:
        checked(tmp_path, track | {"name": "track_1"})
    for part in ("expected 'mine'", "there is a track 'track_1' already", "text_log needs a task with name_2025"):
        assert part in str(caught.value)
    with pytest.raises(DocumentRejected, match="track_1 has a task of that name"):
        checked(tmp_path, track)
    with pytest.raises(DocumentRejected, match="cannot be read"):
        check_track(tmp_path / "missing.yaml")


def test_what_depends_on_the_teams_sensors_is_not_measured(tmp_path: Path) -> None:
    track = load_track("track_3").model_dump(mode="json", exclude_unset=True)
    found = checked(tmp_path, track, "track_3.yaml")
    assert {task.cpu_s for task in found.tasks} == {None}
    assert all("sensors" in (task.note or "") for task in found.tasks)


@pytest.mark.parametrize("settings", ["obs_mode: state", "obs_mode: rgbd", "obs_mode: state, sim_backend: physx_cuda"])
def test_an_environment_of_maniskill_is_checked_without_being_played(tmp_path: Path, settings: str) -> None:
    listed = yaml.safe_load(FILE.replace("obs_mode: state", settings).replace("pick-cube", "pick"))
    found = checked(tmp_path, listed, "cubes.yaml")
    ((task,), (episodes, shards)) = found.tasks, (20, 2)
    assert (task.note, task.cpu_s) == ("environments of ManiSkill are not played here", None)
    assert (task.env_id, task.episodes, task.shards) == ("ManiSkill/PickCube-v1", episodes, shards)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("PickCube-v1", "PickCub-v1", "There is no ManiSkill/PickCub-v1; did you mean 'PickCube-v1'"),
        ("PickCube-v1", "TurnFaucet-v1", "It needs files that ManiSkill downloads: partnet_mobility_faucet"),
        ("obs_mode: state", "obs_mode: rgbx", "obs_mode is 'rgbx', expected one of state, rgb, rgbd, pointcloud"),
        ("pd_ee_delta_pos", "pd_joint_pos", "no control mode 'pd_joint_pos' with actions in"),
    ],
)
def test_what_maniskill_cannot_play_is_refused_when_the_file_is_checked(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    with pytest.raises(DocumentRejected, match=reason):
        checked(tmp_path, yaml.safe_load(FILE.replace(old, new)), "cubes.yaml")
