import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.evaluator.scoring.near_copies import PATH_POINTS, TRACED_STEPS, Likeness, Trace, compare_traces, make_trace

EPISODES, STEPS = 60, 5
Actions = list[NDArray[np.float32]]


def policy(seed: int, *, noise: float = 0.3) -> Actions:
    """Actions of a policy that follows the same starts as others of another seed, with errors of its own."""
    starts = np.random.default_rng(0).uniform(-0.5, 0.5, (EPISODES, 3))
    rng = np.random.default_rng(seed)
    return [np.clip(start + noise * rng.standard_normal((STEPS, 3)), -1, 1).astype(np.float32) for start in starts]


def trace_of(actions: Actions, size: int = 3) -> Trace:
    return make_trace(actions, size, [()] * len(actions))


def likeness(earlier: Actions, later: Actions) -> Likeness:
    return compare_traces(trace_of(earlier), trace_of(later))


def changed(actions: Actions, by: float) -> Actions:
    rng = np.random.default_rng(9)
    return [(each + by * rng.uniform(-1, 1, each.shape)).astype(np.float32) for each in actions]


@pytest.mark.parametrize("by", [0.0, 1e-5, 1e-3, 1e-2])
def test_actions_that_were_changed_a_little_are_a_copy(by: float) -> None:
    source = policy(1)
    found = likeness(source, changed(source, by))
    assert (found.is_copy, found.near, found.episodes) == (True, EPISODES, EPISODES)
    assert found.difference <= by + 1e-6


def test_policies_with_the_same_aim_are_no_copies() -> None:
    found = likeness(policy(1), policy(2))
    assert (found.is_copy, found.near) == (False, 0)
    assert found.difference > 0.1


def test_half_of_the_episodes_make_a_copy() -> None:
    source, other = policy(1), policy(2)
    for copied, is_copy in ((EPISODES // 2 - 1, False), (EPISODES // 2, True)):
        assert likeness(source, changed(source[:copied], 1e-4) + other[copied:]).is_copy is is_copy


def test_a_copy_that_waits_first_is_found() -> None:
    source = policy(1)
    waiting = np.full((1, 3), 0.004, np.float32)
    assert likeness(source, [np.concatenate([waiting, each]) for each in source]).is_copy
    moving = np.full((1, 3), 0.5, np.float32)
    assert not likeness(source, [np.concatenate([moving, each]) for each in source]).is_copy


def test_what_everybody_does_in_every_episode_says_nothing() -> None:
    script = [np.full((STEPS, 3), 0.25, np.float32)] * EPISODES
    assert likeness(script, script) == Likeness(episodes=0, near=0, difference=np.inf)
    limits = [np.sign(each) for each in policy(1)]
    assert not likeness(limits, limits).is_copy


def test_episodes_that_are_played_alike_count_once() -> None:
    repeated = [each for each in policy(1)[:3] for _ in range(20)]
    found = likeness(repeated, repeated)
    assert (found.near, found.episodes, found.is_copy) == (3, EPISODES, False)


def test_a_trace_has_the_first_actions_of_each_episode() -> None:
    short, long = np.zeros((1, 2), np.float32), np.ones((TRACED_STEPS + 3, 2), np.float32)
    trace = trace_of([short, long, np.zeros((0, 2), np.float32)], 2).actions
    assert trace.shape == (3, TRACED_STEPS, 2)
    assert (~np.isnan(trace)).sum(axis=(1, 2)).tolist() == [2, 2 * TRACED_STEPS, 0]


def infos(actions: Actions, *, pressed_mm: float = 0.0) -> list[list[dict[str, object]]]:
    """Infos of a gripper that moves by 2 mm or degrees at an action of 1, whose motion presses the gels."""
    motions = [2.0 * each.cumsum(axis=0) for each in actions]
    return [
        [
            {
                "relative_motion_mm_deg": motion.tolist(),
                "surface_diff_m": [1e-4 * motion[0], 1e-3 * pressed_mm],
            }
            for motion in of_episode
        ]
        for of_episode in motions
    ]


def halved(actions: Actions) -> Actions:
    return [np.repeat(each / 2, 2, axis=0) for each in actions]


def test_actions_that_were_cut_in_two_go_the_same_way() -> None:
    source = policy(1)
    for late in (0, 5):
        later = [np.concatenate([np.zeros((late, 3), np.float32), each]) for each in halved(changed(source, 1e-3))]
        assert not likeness(source, later).is_copy
        found = compare_traces(make_trace(source, 3, infos(source)), make_trace(later, 3, infos(later)))
        assert (found.is_copy, found.near) == (True, EPISODES)


def test_the_same_way_with_other_states_is_no_copy() -> None:
    source, later = policy(1), halved(policy(1))
    other = make_trace(later, 3, infos(later, pressed_mm=0.8))
    assert not compare_traces(make_trace(source, 3, infos(source)), other).is_copy


def test_policies_with_the_same_aim_go_other_ways() -> None:
    first, second = policy(1), policy(2)
    found = compare_traces(make_trace(first, 3, infos(first)), make_trace(second, 3, infos(second)))
    assert found.near == 0


def test_an_episode_that_goes_nowhere_has_no_path() -> None:
    still = [np.zeros((STEPS, 3), np.float32), np.zeros((0, 3), np.float32)]
    paths = make_trace(still, 3, infos(still)).paths
    assert paths.shape == (2, PATH_POINTS, 5)
    assert np.isnan(paths).all()


def test_other_lists_and_actions_are_not_compared() -> None:
    assert not likeness(policy(1), policy(1)[:-1]).is_copy
