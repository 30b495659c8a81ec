"""Several networks for one value."""

import numpy as np
from vitac.training.learning.critic import Ensemble, Samples
from vitac.training.learning.network import Layout, Signs, logits

LAYOUT = Layout(inputs=2, actions=3, hidden=16)
SIGNS = Signs(mirror=np.array([-1, 1], dtype=np.float32), turn=np.array([1, 1], dtype=np.float32))


def samples(count: int = 256) -> tuple[Samples, np.ndarray]:
    """Success where the action's x is towards the input's first number, which both change in the mirror."""
    random = np.random.default_rng(1)
    inputs = random.uniform(-1, 1, (count, 2)).astype(np.float32)
    actions = random.uniform(-1, 1, (count, 3)).astype(np.float32)
    reached = (inputs[:, 0] * actions[:, 0] > 0).astype(np.float32)
    return Samples(inputs=inputs, actions=actions, turnable=np.zeros(count, dtype=np.bool_)), reached


def test_lowest_and_mean_are_those_of_the_networks() -> None:
    ensemble = Ensemble(LAYOUT, 3, np.random.default_rng(0))
    known, _ = samples(5)
    each = [logits(learner.parameters, known.inputs, known.actions) for learner in ensemble.learners]
    np.testing.assert_array_equal(ensemble.lowest(known.inputs, known.actions), np.min(each, axis=0))
    np.testing.assert_allclose(ensemble.mean(known.inputs, known.actions), np.mean(each, axis=0), atol=1e-6)
    assert np.ptp(each, axis=0).min() > 0


def test_learns_what_is_true_of_the_mirror_images_too() -> None:
    ensemble, (known, reached) = Ensemble(LAYOUT, 2, np.random.default_rng(0)), samples()
    random = np.random.default_rng(2)
    losses = [ensemble.epoch(known, reached, SIGNS, random, batch=32, rate=1e-2) for _ in range(30)]
    assert losses[-1] < 0.4 * losses[0]
    changed = SIGNS.changed(known.inputs, known.actions, np.ones(256, dtype=np.bool_), np.zeros(256, dtype=np.bool_))
    found = ensemble.mean(changed[0], changed[1][:, None])[:, 0] > 0
    assert (found == (reached > 0.5)).mean() > 0.9


def test_continued_ensemble_has_the_same_bits() -> None:
    known, reached = samples(64)
    first, other = (Ensemble(LAYOUT, 2, np.random.default_rng(seed)) for seed in (3, 4))
    first.epoch(known, reached, SIGNS, np.random.default_rng(5), batch=16, rate=1e-2)
    other.restore(first.state())
    for each in (first, other):
        each.epoch(known, reached, SIGNS, np.random.default_rng(6), batch=16, rate=1e-2)
    for name, value in first.state().items():
        np.testing.assert_array_equal(value, other.state()[name])
