"""Networks: their gradients, what they learn, how they go on."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from vitac.training.learning.network import (
    STATE,
    Layout,
    Learner,
    TrainingDiverged,
    _forward,
    _gradients,
    logits,
    new_parameters,
    probability,
)

LAYOUT = Layout(inputs=4, actions=3, hidden=16)


def batch(count: int = 32, actions: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    inputs = random.standard_normal((count, 4)).astype(np.float32)
    chosen = random.uniform(-1, 1, (count, actions, 3)).astype(np.float32)
    return inputs, chosen, random.uniform(0, 1, (count, actions)).astype(np.float32)


def loss_of(parameters: dict[str, Any], seen: tuple[Any, Any, Any]) -> float:
    inputs, actions, targets = seen
    chance = 1 / (1 + np.exp(-logits(parameters, inputs, actions).astype(np.float64)))
    return float(-(targets * np.log(chance) + (1 - targets) * np.log(1 - chance)).mean())


@pytest.mark.parametrize("name", ["history", "action", "bias0", "weight1", "bias1", "weight2", "bias2"])
def test_gradients_are_those_of_finite_differences(name: str) -> None:
    # In double precision, so that differences are exact enough.
    parameters: dict[str, Any] = {
        key: value.astype(np.float64) for key, value in new_parameters(LAYOUT, np.random.default_rng(0)).items()
    }
    seen = batch()
    inputs, actions, targets = (_doubled(each) for each in seen)
    first, second, found = _forward(parameters, inputs, actions)
    slope: Any = ((1 / (1 + np.exp(-found)) - targets) / found.size)[..., None]
    gradient = _gradients(parameters, (inputs, actions, first, second), slope)[name]
    for place in list(np.ndindex(parameters[name].shape))[::7]:
        changed = []
        for step in (1e-6, -1e-6):
            moved = {**parameters, name: parameters[name].copy()}
            moved[name][place] += step
            changed.append(loss_of(moved, (inputs, actions, targets)))
        assert gradient[place] == pytest.approx((changed[0] - changed[1]) / 2e-6, abs=1e-7)


def _doubled(values: np.ndarray) -> Any:
    return values.astype(np.float64)


def test_learns_where_success_is_more_likely() -> None:
    learner = Learner(LAYOUT, np.random.default_rng(2))
    inputs, actions, _ = batch(256, 1)
    targets = (inputs[:, None, 0] + actions[..., 0] > 0).astype(np.float32)
    losses = [learner.learn(inputs, actions, targets, rate=1e-2) for _ in range(200)]
    assert losses[-1] < 0.2 * losses[0]
    right = (logits(learner.parameters, inputs, actions) > 0) == (targets > 0.5)
    assert right.mean() > 0.95


def test_continued_learning_has_the_same_bits() -> None:
    seen = batch()
    whole, first = (Learner(LAYOUT, np.random.default_rng(3)) for _ in range(2))
    for _ in range(6):
        whole.learn(*seen, rate=1e-3)
    for _ in range(3):
        first.learn(*seen, rate=1e-3)
    second = Learner(LAYOUT, np.random.default_rng(99))
    second.adam.restore(first.adam.state())
    for _ in range(3):
        second.learn(*seen, rate=1e-3)
    assert second.adam.steps == whole.adam.steps == 6
    for name, value in whole.adam.state().items():
        np.testing.assert_array_equal(value, second.adam.state()[name])


def test_diverged_loss_stops_and_changes_nothing() -> None:
    learner = Learner(LAYOUT, np.random.default_rng(4))
    before = learner.adam.state()
    inputs, actions, targets = batch()
    inputs[0, 0] = np.nan
    with pytest.raises(TrainingDiverged, match="The loss is nan after 0 gradient steps; expected a finite number"):
        learner.learn(inputs, actions, targets, rate=1e-3)
    for name, value in before.items():
        np.testing.assert_array_equal(value, learner.adam.state()[name])


def test_one_set_of_actions_serves_all_inputs() -> None:
    parameters = new_parameters(LAYOUT, np.random.default_rng(5))
    inputs, actions, _ = batch()
    shared = logits(parameters, inputs, actions[0])
    assert shared.shape == (32, 5)
    np.testing.assert_allclose(shared, logits(parameters, inputs, np.repeat(actions[:1], 32, axis=0)), atol=1e-6)


def test_everything_is_single_precision() -> None:
    parameters = new_parameters(LAYOUT, np.random.default_rng(6))
    inputs, actions, _ = batch()
    assert {value.dtype for value in parameters.values()} == {np.dtype(np.float32)}
    assert logits(parameters, inputs, actions).dtype == np.float32


def test_probabilities_do_not_overflow() -> None:
    found = probability(np.array([-1e4, 0.0, 1e4], dtype=np.float32))
    assert found.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("are_drawn", [True, False])
def test_images_are_drawn_where_they_could_have_been_played(are_drawn: bool) -> None:
    random = np.random.default_rng(7)
    inputs = random.uniform(1, 2, (200, len(STATE.mirror))).astype(np.float32)
    actions = random.uniform(1, 2, (200, 3)).astype(np.float32)
    signs = replace(STATE, are_drawn=are_drawn)
    seen, chosen = signs.drawn(inputs, actions, np.ones(200, dtype=np.bool_), random)
    assert (len(np.unique(np.sign(chosen), axis=0)), len(np.unique(np.sign(seen), axis=0))) == (
        (4, 4) if are_drawn else (1, 1)
    )
