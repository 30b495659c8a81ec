"""The scripted example policies of ManiSkill's track."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from example_policies import imported
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.envs.tasks.definition import Family
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.tracks import load_track


@pytest.fixture(scope="module")
def modules(repository: Path) -> Iterator[SimpleNamespace]:
    with imported(repository / "examples/maniskill/ManiSkill") as modules:
        yield modules


@pytest.fixture(scope="module")
def policy(modules: SimpleNamespace) -> SimpleNamespace:
    found: SimpleNamespace = modules.pick_cube
    return found


def state(policy: SimpleNamespace, *, to_cube: list[float], to_goal: list[float], grasped: bool = False) -> np.ndarray:
    values = np.zeros(42, np.float32)
    values[policy.IS_GRASPED] = grasped
    values[policy.TCP_TO_CUBE], values[policy.CUBE_TO_GOAL] = to_cube, to_goal
    return values


@pytest.mark.parametrize(
    ("to_cube", "grasped", "expected"),
    [
        ([0.05, 0.0, -0.1], False, [0.5, 0.0, -0.4, 1.0]),  # above it first, open
        ([0.0, 0.01, -0.05], False, [0.0, 0.1, -0.5, 1.0]),  # straight down
        ([0.0, 0.0, -0.01], False, [0.0, 0.0, 0.0, -1.0]),  # close on it
        ([0.0, 0.0, 0.0], True, [0.2, -1.0, 1.0, -1.0]),  # to the goal, closed
    ],
)
def test_goes_above_the_cube_then_down_then_closes_then_to_the_goal(
    policy: SimpleNamespace, to_cube: list[float], grasped: bool, expected: list[float]
) -> None:
    observed = state(policy, to_cube=to_cube, to_goal=[0.02, -0.3, 0.3], grasped=grasped)
    action = policy.PickCube().act({"state": observed})
    assert action.dtype == np.float32
    np.testing.assert_allclose(action, expected, atol=1e-6)


def test_the_parts_of_the_state_of_pick_cube_are_where_the_track_says(policy: SimpleNamespace) -> None:
    task = load_track("maniskill").tasks["pick-cube"]
    assert (task.definition.family, len(task.episodes), len(task.actions)) == (Family.MANISKILL, 100, 4)
    (observed,) = task.observables
    for part, place in (
        ("extra_is_grasped", f"{policy.IS_GRASPED}"),
        ("extra_tcp_to_obj_pos", f"{policy.TCP_TO_CUBE.start} to {policy.TCP_TO_CUBE.stop - 1}"),
        ("extra_obj_to_goal_pos", f"{policy.CUBE_TO_GOAL.start} to {policy.CUBE_TO_GOAL.stop - 1}"),
    ):
        assert f"{place} {part}" in observed.meaning


class Scene:
    """A gripper and a peg before a box, moved as they are told to; the peg goes with the closed gripper."""

    def __init__(self, modules: SimpleNamespace) -> None:
        self._insertion, self._rotations = modules.side_peg_insertion, modules.rotations
        self.tcp = [0.0, 0.0, 0.2, 0.0, 1.0, 0.0, 0.0]
        self.peg = [0.1, -0.2, 0.02, np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)]
        self.hole = [0.0, 0.3, 0.1, np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)]
        self.gripper = 1.0

    def observation(self) -> dict[str, np.ndarray]:
        values = np.zeros(43, np.float32)
        values[self._insertion.TCP], values[self._insertion.PEG] = self.tcp, self.peg
        values[self._insertion.HOLE], values[self._insertion.PEG_HALF_LENGTH] = self.hole, 0.1
        return {"state": values}

    def move(self, action: np.ndarray) -> None:
        """Follow the action in position, the peg with it where it is held; no turn is needed here but the first."""
        assert action.shape == (7,)
        assert (np.abs(action) <= 1.0).all()
        self.gripper = action[6]
        self.tcp[:3] = np.add(self.tcp[:3], 0.05 * action[:3]).tolist()
        if np.abs(action[3:6]).max() > 0.5:
            self.tcp[3:] = [0.0, np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0]
        if self.gripper < 0:
            self.peg[:3] = np.add(self.peg[:3], 0.05 * action[:3]).tolist()


def test_the_peg_is_held_by_its_tail_lifted_before_the_hole_and_pushed_in_along_it(modules: SimpleNamespace) -> None:
    scene, script = Scene(modules), modules.side_peg_insertion.SidePegInsertion()
    heights, closed_at = [], None
    for _ in range(100):
        scene.move(script.act(scene.observation()))
        heights.append(scene.peg[2])
        if scene.gripper < 0 and closed_at is None:
            closed_at = np.subtract(scene.tcp[:3], scene.peg[:3])
        if scene.peg[1] + 0.1 > scene.hole[1] - 0.015:
            break
    else:
        raise AssertionError("the peg is not in the hole")
    assert closed_at is not None
    np.testing.assert_allclose(closed_at, [0.0, -0.06, 0.0], atol=0.013)
    np.testing.assert_allclose([scene.peg[0], scene.peg[2]], [scene.hole[0], scene.hole[2]], atol=0.003)
    assert max(heights) < 0.12


def test_the_parts_of_the_state_of_the_insertion_are_where_the_track_says(modules: SimpleNamespace) -> None:
    script, task = modules.side_peg_insertion, load_track("maniskill").tasks["side-peg-insertion"]
    (observed,) = task.observables
    for part, place in (
        ("extra_tcp_pose", f"{script.TCP.start} to {script.TCP.stop - 1}"),
        ("extra_peg_pose", f"{script.PEG.start} to {script.PEG.stop - 1}"),
        ("extra_peg_half_size", f"{script.PEG_HALF_LENGTH} to {script.PEG_HALF_LENGTH + 2}"),
        ("extra_box_hole_pose", f"{script.HOLE.start} to {script.HOLE.stop - 1}"),
    ):
        assert f"{place} {part}" in observed.meaning
    turning, held = next(row for row in task.actions if row.name == "rx"), task.actions[0]
    assert (turning.scale, held.scale) == (script.STEP_RAD, script.STEP_M)


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=50)
def test_rotations_are_rotations_and_a_vector_turns_as_its_matrix(modules: SimpleNamespace, q: list[float]) -> None:
    matrix = modules.rotations.matrix(np.array(q))
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-9)
    vector = modules.rotations.vector(matrix)
    np.testing.assert_allclose(matrix @ vector, vector, atol=1e-6)
    angle = np.linalg.norm(vector)
    if 1e-3 < angle < 3.0:
        np.testing.assert_allclose(2.0 * np.cos(angle) + 1.0, np.trace(matrix), atol=1e-6)


def test_every_task_of_the_submission_has_a_script(modules: SimpleNamespace, repository: Path) -> None:
    manifest = load_manifest(repository / "examples/maniskill/ManiSkill")
    policy = modules.policy.Policy()
    assert sorted(manifest.tasks) == sorted(modules.policy.SCRIPTS)
    for task in manifest.tasks:
        policy.reset(task)
        listed = load_track("maniskill").tasks[task]
        filled = np.full(listed.observables[0].shape, 0.1, np.float32)
        assert policy.act({"state": filled}).shape == (len(listed.actions),)
