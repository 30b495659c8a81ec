"""The gradient steps equal those of the plain networks and of Stable-Baselines3 within rounding."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch, of which the challenge's networks are made, is not installed")
stable_baselines3 = pytest.importorskip(
    "stable_baselines3", reason="Stable-Baselines3, which has TD3, is not installed"
)

from stable_baselines3.common.logger import configure  # noqa: E402
from toy_touch import ToyTouch  # noqa: E402
from vitac.training.learning.network import TrainingDiverged  # noqa: E402
from vitac.training.reference.gradients import CLOUDS_AT_ONCE, CachedPointNet  # noqa: E402
from vitac.training.reference.hyperparameters import HYPERPARAMETERS  # noqa: E402
from vitac.training.reference.policy import PointNet  # noqa: E402
from vitac.training.reference.td3 import new_model  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def both_encoders() -> tuple[Any, Any]:
    torch.manual_seed(0)
    plain, cached = PointNet(4, 32), CachedPointNet(4, 32)
    cached.load_state_dict(plain.state_dict())
    return plain, cached


@pytest.mark.parametrize("sets", [1, CLOUDS_AT_ONCE + 1])
def test_encoder_computes_the_numbers_and_gradients_of_the_plain_one(sets: int) -> None:
    plain, cached = both_encoders()
    points = torch.randn(sets, 2, 128, 4)
    with torch.no_grad():
        assert cached(points[:0]).shape == (0, 2, 32)
        torch.testing.assert_close(cached(points), plain(points), rtol=1e-4, atol=1e-5)
    own = points.clone().requires_grad_()
    theirs = points.clone().requires_grad_()
    weights = torch.randn(sets, 2, 32)
    (cached(own) * weights).sum().backward()
    (plain(theirs) * weights).sum().backward()
    torch.testing.assert_close(own.grad, theirs.grad, rtol=1e-3, atol=1e-5)
    for found, expected in zip(cached.parameters(), plain.parameters(), strict=True):
        torch.testing.assert_close(found.grad, expected.grad, rtol=1e-3, atol=1e-4 * float(expected.grad.abs().max()))


def test_gradient_of_equal_points_is_counted_once_as_in_the_plain_encoder() -> None:
    plain, cached = both_encoders()
    points = torch.randn(1, 1, 1, 4).expand(1, 1, 5, 4)
    found, expected = points.clone().requires_grad_(), points.clone().requires_grad_()
    cached(found).sum().backward()
    plain(expected).sum().backward()
    torch.testing.assert_close(found.grad.sum(dim=-2), expected.grad.sum(dim=-2), rtol=1e-3, atol=1e-6)


def model_with_transitions() -> Any:
    chosen = replace(HYPERPARAMETERS["peg-insertion"], batch_size=20, buffer_size=60)
    env = ToyTouch(chosen.truths, 3)
    model = new_model("peg-insertion", chosen, env)
    model.set_logger(configure(None, []))
    random = np.random.default_rng(0)
    for number in range(40):
        seen = {key: box.sample()[None] / 1e3 for key, box in env.observation_space.spaces.items()}  # type: ignore[attr-defined]
        after = {key: value + 0.1 for key, value in seen.items()}
        action = random.uniform(-1, 1, (1, 3))
        model.replay_buffer.add(seen, after, action, np.array([-1.0]), np.array([number % 4 == 0]), [{}])
    return model


def trained(model: Any, train: Any, steps: int) -> Any:
    """Return a copy after gradient steps with the same random numbers."""
    copy = deepcopy(model)
    np.random.seed(3)  # noqa: NPY002 - Stable-Baselines3 draws from it
    torch.manual_seed(3)
    train(copy, steps, 20)
    return copy


def test_gradient_steps_are_those_of_stable_baselines3() -> None:
    model = model_with_transitions()
    found = trained(model, type(model).train, 5)
    expected = trained(model, stable_baselines3.TD3.train, 5)
    assert found._n_updates == expected._n_updates == 5
    before = model.policy.state_dict()
    changed = 0
    for name, value in expected.policy.state_dict().items():
        torch.testing.assert_close(found.policy.state_dict()[name], value, rtol=1e-3, atol=2e-5, msg=name)
        changed += not torch.equal(value, before[name])
    assert changed > 60
    for key in ("train/actor_loss", "train/critic_loss"):
        assert np.isfinite(found.logger.name_to_value[key])
    actor_loss = expected.logger.name_to_value["train/actor_loss"]
    assert found.logger.name_to_value["train/actor_loss"] == pytest.approx(actor_loss, rel=1e-3)
    assert all(parameter.requires_grad for parameter in found.critic.parameters())


def test_loss_that_is_no_number_stops_before_anything_is_changed() -> None:
    model = model_with_transitions()
    model.replay_buffer.rewards[:] = np.nan
    before = deepcopy(model.policy.state_dict())
    with pytest.raises(
        TrainingDiverged, match="The loss of the critic is nan in gradient step 1; expected a finite number"
    ):
        model.train(1, 20)
    for name, value in model.policy.state_dict().items():
        assert torch.equal(value, before[name]), name
