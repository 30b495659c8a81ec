"""The network of a clone: its gradients, what it learns, and that its weights decay."""

import numpy as np
import pytest
from vitac.training.cloning.playing import CAUTION, Loss, Network, cautious, compute_gradients, squared
from vitac.training.cloning.policy import compute_layers
from vitac.training.learning.network import TrainingDiverged


def test_gradients_are_those_of_differences() -> None:
    random = np.random.default_rng(0)
    network = Network((4, 12, 11, 2), random)
    parameters = {name: value.astype(np.float64) for name, value in network.parameters.items()}
    inputs, actions = random.standard_normal((7, 4)), random.standard_normal((7, 2))

    def loss() -> float:
        return float(((compute_layers(parameters, inputs)[-1] - actions) ** 2).sum())  # type: ignore[arg-type]

    layers = compute_layers(parameters, inputs)  # type: ignore[arg-type]
    gradients = compute_gradients(parameters, layers, 2.0 * (layers[-1] - actions))  # type: ignore[arg-type]
    for name, value in parameters.items():
        place = (0,) * value.ndim
        value[place] += 1e-6
        above = loss()
        value[place] -= 2e-6
        below = loss()
        value[place] += 1e-6
        assert gradients[name][place] == pytest.approx((above - below) / 2e-6, rel=1e-4, abs=1e-6), name


def test_learns_and_weights_decay() -> None:
    random = np.random.default_rng(1)
    inputs = random.standard_normal((64, 3)).astype(np.float32)
    actions = inputs[:, :2] - inputs[:, 2:]
    sizes = {}
    for decay in (0.0, 5.0):
        network = Network((3, 16, 16, 2), np.random.default_rng(2))
        losses = [network.learn(inputs, actions, rate=3e-3, decay=decay, loss=squared) for _ in range(200)]
        assert losses[-1] < losses[0] / 5
        sizes[decay] = sum(float(np.square(network.parameters[f"weight{number}"]).sum()) for number in range(3))
    assert sizes[5.0] < 0.7 * sizes[0.0]


def test_loss_that_is_no_number_stops() -> None:
    network = Network((1, 2, 2, 1), np.random.default_rng(0))
    with pytest.raises(TrainingDiverged, match="The loss is nan after 0 gradient steps"):
        network.learn(
            np.full((1, 1), np.nan, np.float32), np.zeros((1, 1), np.float32), rate=1e-3, decay=0.0, loss=squared
        )


@pytest.mark.parametrize("loss", [squared, cautious])
def test_slopes_of_a_loss_are_those_of_differences(loss: Loss) -> None:
    random = np.random.default_rng(3)
    outputs, actions = random.standard_normal((2, 5, 2))
    outputs[0] = actions[0] + 0.01
    _, slopes = loss(outputs, actions)
    for place in np.ndindex(outputs.shape):
        above, below = outputs.copy(), outputs.copy()
        above[place] += 1e-6
        below[place] -= 1e-6
        difference = (loss(above, actions)[0] - loss(below, actions)[0]) / 2e-6
        assert slopes[place] == pytest.approx(difference, rel=1e-4, abs=1e-7), place


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_cautious_policy_goes_less_far_than_most_of_what_the_expert_does(sign: float) -> None:
    network = Network((1, 8, 8, 1), np.random.default_rng(4))
    actions = sign * np.linspace(0.0, 1.0, 201, dtype=np.float32)[:, np.newaxis]
    inputs = np.ones_like(actions)
    for step in range(600):
        network.learn(inputs, actions, rate=1e-2 * 0.1 ** (step / 300), decay=0.0, loss=cautious)
    [output] = compute_layers(network.parameters, inputs[:1])[-1][0]
    assert output == pytest.approx(sign * CAUTION, abs=0.03)
