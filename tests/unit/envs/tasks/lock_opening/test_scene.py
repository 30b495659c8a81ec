from typing import Any

import numpy as np
import pytest
from vitac.envs.geometry.keys_and_locks import KeyShape
from vitac.envs.tasks.lock_opening.env import LockOpeningEnv
from vitac.envs.tasks.lock_opening.scene import KeyOffset, LockStart, SensorJitter
from vitac.envs.tasks.settings import ResetOptionsError

GOLDEN_START = LockStart(
    shape=KeyShape.KEY3,
    offset=KeyOffset(x_mm=2.7856902510311317, y_mm=0.0, z_mm=0.0),
    jitter=SensorJitter(x_mm=1.6018161737839443, z_mm=1.9130276349506772),
)


ENV = LockOpeningEnv()


def start(options: dict[str, Any], seed: int = 0) -> LockStart:
    return ENV.choose_start(options, np.random.default_rng(seed), ENV.settings)


def test_given_start_is_taken_and_draws_nothing() -> None:
    random = np.random.default_rng(0)
    options = {"shape": "key3", "offset_mm": (4.75, 0, 0), "sensor_jitter_mm": (-1.5, 0.25)}
    chosen = ENV.choose_start(options, random, ENV.settings)
    assert chosen.shape is KeyShape.KEY3
    assert chosen.offset == KeyOffset(x_mm=4.75, y_mm=0.0, z_mm=0.0)
    assert chosen.jitter == SensorJitter(x_mm=-1.5, z_mm=0.25)
    assert random.bit_generator.state == np.random.default_rng(0).bit_generator.state


def test_random_starts_cover_keys_offsets_and_jitter() -> None:
    drawn = [start({}, seed) for seed in range(400)]
    assert {chosen.shape for chosen in drawn} == set(KeyShape)
    x_mm = [chosen.offset.x_mm for chosen in drawn]
    assert 0 <= min(x_mm) < 0.2 < 4.8 < max(x_mm) < 5
    assert {(chosen.offset.y_mm, chosen.offset.z_mm) for chosen in drawn} == {(0.0, 0.0)}
    for values in ([chosen.jitter.x_mm for chosen in drawn], [chosen.jitter.z_mm for chosen in drawn]):
        assert -2 < min(values) < -1.9
        assert 1.9 < max(values) < 2
        assert np.mean(values) == pytest.approx(0.0, abs=0.2)


def test_jitter_of_a_listed_episode_comes_from_the_generator() -> None:
    options = {"shape": "key1", "offset_mm": (1.0, 0.0, 0.0)}
    assert start(options, 3) == start(options, 3)
    assert start(options, 3).jitter != start(options, 4).jitter


@pytest.mark.parametrize("shape", ["key5", 1, "cuboid"])
def test_unknown_key_is_refused(shape: Any) -> None:
    with pytest.raises(ResetOptionsError, match="expected one of key1, key2, key3, key4"):
        start({"shape": shape})


@pytest.mark.parametrize(
    "offset", [(1, 2), 3, "abc", (-1.5, 0, 0), (41, 0, 0), (0, 0.9, 0), (0, 0, -0.9), (0, 0, None)]
)
def test_offset_that_does_not_fit_the_channel_is_refused(offset: Any) -> None:
    with pytest.raises(ResetOptionsError, match=r"'offset_mm' is .*expected \(x, y, z\) in mm with -1\.4 <= x <= 40"):
        start({"offset_mm": offset})


@pytest.mark.parametrize("jitter", [(1, 2, 3), 1.0, (4.1, 0), (0, float("inf")), ("a", "b")])
def test_unusable_jitter_is_refused(jitter: Any) -> None:
    with pytest.raises(ResetOptionsError, match=r"'sensor_jitter_mm' is .*within 4 either way"):
        start({"sensor_jitter_mm": jitter})


def test_golden_random_starts_are_pinned() -> None:
    """The draws of a random start belong to the evaluator version."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([0, 1])))
    assert ENV.choose_start({}, random, ENV.settings) == GOLDEN_START
