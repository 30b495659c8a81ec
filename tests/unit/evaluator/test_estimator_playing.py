import numpy as np
from vitac.evaluator.estimator import COUNT, EstimatorSession
from vitac.evaluator.regression import Coefficients, Regression

SCALE = (2.0, 2.0, 4.0)
# The first feature is the common motion along u in the left picture; the estimate of x is that.
WEIGHTS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), *(((0.0,) * 3,) * (COUNT + 2)))
COEFFICIENTS = Coefficients(
    mesh_hash="m",
    starts=1,
    regressions=(
        Regression(means=(0.0,) * (COUNT + 3), scales=(1.0,) * (COUNT + 3), weights=WEIGHTS, variances=(1.0,) * 3),
    ),
)


def observation(motion_px: float) -> dict[str, np.ndarray]:
    grid = np.stack(np.meshgrid(np.linspace(20, 300, 8), np.linspace(20, 220, 6)), axis=-1).reshape(-1, 2)
    flow = np.stack([np.stack([grid, grid + np.array([motion_px, 0.0])])] * 2)
    return {"marker_flow": flow.astype(np.float32), "relative_motion": np.zeros(4, np.float32)}


def test_action_follows_from_the_markers() -> None:
    session = EstimatorSession(COEFFICIENTS, SCALE, is_blind=False)
    with session.episode(task="sensor-standard", action_shape=(3,)) as policy:
        action = policy.act(observation(1.0))
    assert action.dtype == np.float32
    np.testing.assert_allclose(action, [-0.5, 0.0, 0.0], atol=0.01)
    assert policy.cpu_s > 0.0
    assert (policy.channel_s, policy.output, session.isolation) == (0.0, "", None)


def test_blind_run_does_not_see_the_markers_move() -> None:
    with EstimatorSession(COEFFICIENTS, SCALE, is_blind=True).episode(task="t", action_shape=(3,)) as policy:
        assert policy.act(observation(1.0)).tolist() == [0.0, 0.0, 0.0]


def test_nothing_is_remembered_from_one_episode_to_the_next() -> None:
    session = EstimatorSession(COEFFICIENTS, SCALE, is_blind=False)
    actions = []
    for _ in range(2):
        with session.episode(task="t", action_shape=(3,)) as policy:
            actions.append([policy.act(observation(value)).tolist() for value in (3.0, 1.0)])
    assert actions[0] == actions[1]
