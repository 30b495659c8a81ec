"""What critic and assessor have in common: targets of each sweep, and the losses of its epochs."""

import numpy as np
import pytest
from vitac.training.learning.critic import FittedValue, FittingPlan, Samples
from vitac.training.learning.network import FloatArray, Signs, TrainingDiverged, probability

INPUTS = 4
STAYS = Signs(mirror=np.ones(INPUTS, dtype=np.float32), turn=np.ones(INPUTS, dtype=np.float32))


class Plan(FittingPlan):
    networks: int = 2
    hidden: int = 16
    sweeps: int = 3
    epochs: int = 2
    batch: int = 16
    rate: float = 5e-3
    discount: float = 1.0


def samples(count: int = 64, seed: int = 0) -> Samples:
    random = np.random.default_rng(seed)
    return Samples(
        inputs=random.standard_normal((count, INPUTS)).astype(np.float32),
        actions=random.uniform(-1, 1, (count, 3)).astype(np.float32),
        turnable=np.zeros(count, dtype=np.bool_),
    )


def made(plan: Plan, seed: int = 1) -> FittedValue:
    return FittedValue(plan, INPUTS, STAYS, np.random.default_rng(seed))


def fit(value: FittedValue, known: Samples, wanted: FloatArray, seed: int = 2) -> list[tuple[int, float]]:
    told: list[tuple[int, float]] = []
    value._fit(known, lambda: wanted, np.random.default_rng(seed), lambda sweep, loss: told.append((sweep, loss)))
    return told


def test_targets_are_asked_for_at_the_beginning_of_every_sweep() -> None:
    value, known = made(Plan()), samples()
    asked: list[int] = []
    told: list[tuple[int, float]] = []

    def targets() -> FloatArray:
        asked.append(len(told))
        return np.full(len(known.inputs), 0.5, dtype=np.float32)

    value._fit(known, targets, np.random.default_rng(2), lambda sweep, loss: told.append((sweep, loss)))
    assert asked == [0, 1, 2]
    assert [sweep for sweep, _ in told] == [0, 1, 2]
    assert all(0 < loss < 1 for _, loss in told)


def test_it_comes_to_give_what_is_wanted() -> None:
    known = samples(128)
    wanted = np.where(known.inputs[:, 0] > 0, np.float32(0.9), np.float32(0.1))
    value = made(Plan(networks=1, sweeps=12, epochs=10))
    told = fit(value, known, wanted)
    assert told[-1][1] < 0.7 * told[0][1]
    found = probability(value.log_odds(known.inputs, known.actions[:, None])[:, 0])
    assert found[wanted > 0.5].mean() > 0.7 > 0.3 > found[wanted < 0.5].mean()


def test_a_plan_without_sweeps_changes_nothing() -> None:
    value = made(Plan(sweeps=0))
    before = {name: array.copy() for name, array in value.state().items()}
    assert fit(value, samples(), np.zeros(64, dtype=np.float32)) == []
    for name, array in value.state().items():
        np.testing.assert_array_equal(array, before[name])


def test_equal_draws_give_equal_bits_and_a_state_goes_on() -> None:
    known, wanted = samples(), np.full(64, 0.25, dtype=np.float32)
    one, other, third = made(Plan()), made(Plan()), made(Plan(), seed=9)
    assert fit(one, known, wanted) == fit(other, known, wanted)
    third.restore(one.state())
    assert fit(one, known, wanted, seed=3) == fit(third, known, wanted, seed=3)
    for name, array in one.state().items():
        np.testing.assert_array_equal(array, third.state()[name])


def test_every_action_of_a_row_has_a_value_of_its_own() -> None:
    value, known = made(Plan()), samples(5)
    few = np.array([[0, 0, 0], [1, 0, -1]], dtype=np.float32)
    found = value.log_odds(known.inputs, few)
    assert found.shape == (5, 2)
    np.testing.assert_allclose(found[:, :1], value.log_odds(known.inputs, few[:1]), rtol=1e-5)


def test_a_loss_that_is_no_number_stops_the_fit() -> None:
    with pytest.raises(TrainingDiverged):
        fit(made(Plan()), samples(), np.full(64, np.nan, dtype=np.float32))
