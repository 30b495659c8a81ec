import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.drawing.drawable import straight_to_target
from vitac.envs.drawing.playback import TRUE_OFFSET, EpisodePlayback, Pace, record
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.peg_insertion.env import PegInsertionEnv
from vitac.envs.tasks.task_env import Info, Observation

OPTIONS = {"shape": "cuboid", "offset_mm_deg": (2.0, -1.0, 3.0), "rng_seed": (0, 1)}


def still(_: Observation, __: Info) -> np.ndarray:
    return np.zeros(3, dtype=np.float32)


def test_keeps_the_reset_and_every_env_step(fake_scenes: list[FakeScene]) -> None:
    playback = record(PegInsertionEnv(max_steps=2), options=OPTIONS, next_action=still)
    assert [moment.env_step for moment in playback.moments] == [0, 1, 2]
    assert playback.last_moments == (0, 1, 2)
    assert [moment.end_reason for moment in playback.moments] == [None, None, "steps"]


def test_keeps_every_ipc_step_between_them(fake_scenes: list[FakeScene]) -> None:
    env = PegInsertionEnv()
    env.reset(options=OPTIONS)
    before = env.ipc_steps
    playback = record(env, options=OPTIONS, next_action=straight_to_target(env.env_id), pace=Pace.IPC_STEP)
    played = env.ipc_steps - 2 * before
    assert len(playback.moments) == 1 + played
    ends = [playback.moments[index] for index in playback.last_moments]
    assert [moment.env_step for moment in ends] == list(range(len(ends)))
    assert ends[-1].end_reason == "success"
    between = playback.moments[1]
    assert between.env_step == 1
    assert between.marker_flow is playback.moments[0].marker_flow
    assert not np.array_equal(between.held_m, playback.moments[0].held_m)


def test_keeping_ipc_steps_changes_nothing_that_is_played(fake_scenes: list[FakeScene]) -> None:
    hashes, flows = [], []
    for pace in Pace:
        env = PegInsertionEnv()
        playback = record(env, options=OPTIONS, next_action=straight_to_target(env.env_id), pace=pace)
        hashes.append(env.state_hash())
        flows.append([playback.moments[index].marker_flow for index in playback.last_moments])
    assert hashes[0] == hashes[1]
    assert np.array_equal(flows[0], flows[1])


def test_stops_where_the_actions_end(fake_scenes: list[FakeScene]) -> None:
    remaining = iter(np.zeros((2, 3), dtype=np.float32))
    playback = record(PegInsertionEnv(), options=OPTIONS, next_action=lambda *_: next(remaining, None))
    assert [moment.env_step for moment in playback.moments] == [0, 1, 2]
    assert playback.moments[-1].end_reason is None


def test_keeps_actions_and_rewards_of_the_env_steps(fake_scenes: list[FakeScene]) -> None:
    given = np.array([[0.5, 0.0, -0.25], [0.0, 1.0, 0.0]], dtype=np.float32)
    remaining = iter(given)
    env = PegInsertionEnv()
    playback = record(env, options=OPTIONS, next_action=lambda *_: next(remaining, None))
    assert np.array_equal(playback.actions, given)
    env.reset(options=OPTIONS)
    assert playback.rewards.tolist() == [env.step(action)[1] for action in given]


def test_without_an_action_there_is_none_and_no_reward(fake_scenes: list[FakeScene]) -> None:
    playback = record(PegInsertionEnv(), options=OPTIONS, next_action=lambda *_: None)
    assert playback.actions.shape == (0, 3)
    assert playback.rewards.shape == (0,)


def test_moments_do_not_change_with_the_scene(peg_playback: EpisodePlayback) -> None:
    heights_m = [moment.held_m[:, 2].min() for moment in peg_playback.moments]
    assert np.diff(heights_m) == pytest.approx(-0.125e-3)
    first, last = peg_playback.moments[0], peg_playback.moments[-1]
    assert first.sensor_poses[0].centre_m[2] > last.sensor_poses[0].centre_m[2]


def test_the_fixed_part_is_given_in_the_world(peg_playback: EpisodePlayback) -> None:
    assert peg_playback.env_id == "ViTac/PegInsertion-v1"
    assert 1e3 * peg_playback.fixed_m.min(axis=0) == pytest.approx([-35, -25, 0])
    assert peg_playback.gel.rest_position_m.shape == (162, 3)


def test_what_a_policy_believes_is_kept_from_the_moment_at_which_it_looked(fake_scenes: list[FakeScene]) -> None:
    said = iter([None, np.array([2.5, -1.0, 3.0], dtype=np.float32), None])
    asked: list[int] = []

    def belief(size: int) -> np.ndarray | None:
        asked.append(size)
        return next(said)

    env = PegInsertionEnv(max_steps=3)
    action = np.array([0.5, 0.0, 0.25], dtype=np.float32)
    for pace in Pace:
        said = iter([None, np.array([2.5, -1.0, 3.0], dtype=np.float32), None])
        playback = record(env, options=OPTIONS, next_action=lambda *_: action, belief=belief, pace=pace)
        ends = [playback.moments[index] for index in playback.last_moments]
        assert [moment.env_step for moment in playback.looks] == [0, 1, 2]
        assert [moment.belief_error is None for moment in ends] == [True, False, False, False]
        true = [moment.info[TRUE_OFFSET] for moment in ends]
        for moment, now in zip(ends[1:], true[1:], strict=True):
            done = now - true[1]
            assert moment.believed == pytest.approx(np.add(done, [2.5, -1.0, 3.0])), "carried on by what was done"
        assert all(moment.believed is not None for moment in playback.moments if moment.env_step > 1)
    assert asked == [3] * 6


def test_nothing_is_believed_where_nobody_is_asked_or_the_task_has_no_offset(
    peg_playback: EpisodePlayback, fake_scenes: list[FakeScene]
) -> None:
    assert {moment.believed is None for moment in peg_playback.moments} == {True}
    options = {"shape": "key1", "offset_mm": (0.0, 0.0, 0.0), "rng_seed": (0, 1)}
    remaining = iter(np.zeros((1, 2), dtype=np.float32))

    def refuse(_: int) -> np.ndarray:
        raise AssertionError("asked for the offset of a key")

    playback = record(LockOpeningEnv(), options=options, next_action=lambda *_: next(remaining, None), belief=refuse)
    assert [moment.belief_error for moment in playback.moments] == [None, None]
