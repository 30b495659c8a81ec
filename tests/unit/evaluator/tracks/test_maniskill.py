"""The track of ManiSkill that is shipped; read without ManiSkill."""

import pytest
from vitac.envs.maniskill.definition import catalogue
from vitac.envs.tasks.definition import Family
from vitac.evaluator.tracks import Task, list_tracks, load_track
from vitac.evaluator.tracks.registry import archive_folders

TRACK = load_track("maniskill")
COUNT = (
    *("PickCube-v1", "PushCube-v1", "StackCube-v1", "PegInsertionSide-v1", "PlugCharger-v1"),
    *("LiftPegUpright-v1", "PullCube-v1", "PokeCube-v1", "RollBall-v1"),
)


def test_it_has_every_environment_that_can_be_a_task_once() -> None:
    environments = [task.env_id.removeprefix("ManiSkill/") for task in TRACK.tasks.values()]
    assert sorted(environments) == sorted(catalogue().environments)


def test_the_nine_named_tasks_count() -> None:
    counting = [TRACK.tasks[name].env_id.removeprefix("ManiSkill/") for name in TRACK.tasks_that_count]
    assert sorted(counting) == sorted(COUNT)


def test_it_stands_after_ours_on_the_pages_and_has_a_folder_of_its_own() -> None:
    assert list_tracks()[-1] == "maniskill"
    assert (TRACK.has_maniskill, load_track("track_1").has_maniskill) == (True, False)
    assert archive_folders()[-1] == TRACK.folder == "ManiSkill"


@pytest.mark.parametrize("task", TRACK.tasks.values(), ids=lambda task: task.name)
def test_each_task_is_played_by_state_on_the_cpu_from_a_hundred_seeds(task: Task) -> None:
    family = Family.MANISKILL_PICTURES if task.name == "push-t" else Family.MANISKILL  # made of drawn shapes
    assert (task.definition.family, task.definition.repeats) == (family, True)
    assert [row.name for row in task.observables] == ["state"]
    assert {episode.options["rng_seed"] for episode in task.episodes} == {(0, number) for number in range(1, 101)}
