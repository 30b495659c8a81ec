import signal
from collections.abc import Iterator
from types import FrameType
from typing import Any

import gymnasium
import numpy as np
import pytest
import vitac.envs  # noqa: F401 - registers the environments
from vitac.envs.compilation import kernel, numba_internals
from vitac.envs.signals import signals_act, signals_wait


class Stopped(Exception):
    """What a handler raises."""


@pytest.fixture(autouse=True)
def _handlers() -> Iterator[None]:
    def stop(number: int, _: FrameType | None) -> None:
        raise Stopped(signal.Signals(number).name)

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_what_arrives_while_signals_wait_is_handled_once_and_after_the_block() -> None:
    reached = False
    with pytest.raises(Stopped, match="SIGTERM"), signals_wait(), signals_wait():  # noqa: PT012 - it raises at its end
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        reached = True
    assert reached
    with signals_wait():
        pass  # nothing is left over


def test_it_is_handled_where_the_block_fails_too() -> None:
    with pytest.raises(Stopped) as caught, signals_wait():  # noqa: PT012 - as above
        signal.raise_signal(signal.SIGINT)
        raise ValueError
    assert isinstance(caught.value.__context__, ValueError)
    with pytest.raises(Stopped):
        signal.raise_signal(signal.SIGINT)


def test_signals_act_where_a_kernel_is_compiled() -> None:
    with signals_wait():
        with pytest.raises(Stopped), signals_act():
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        reached = False
        with pytest.raises(Stopped), signals_act():
            reached = True
        assert not reached, "it was handled before"


@kernel
def doubled(x: float) -> float:
    return 2 * x


def test_the_compilation_of_a_kernel_is_stopped_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    went_on = False

    def taken(*_: object) -> None:
        nonlocal went_on
        signal.raise_signal(signal.SIGINT)
        went_on = True
        raise ValueError

    monkeypatch.setattr(numba_internals.KernelCache, "holds", lambda *_: False)
    monkeypatch.setattr(numba_internals._TURN, "taken", taken)
    with pytest.raises(Stopped), signals_wait():
        doubled(1.0)
    assert not went_on


def test_a_signal_that_is_ignored_stays_so() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with signals_wait():
        signal.raise_signal(signal.SIGINT)


def test_an_env_step_is_played_to_its_end() -> None:
    env: Any = gymnasium.make("ViTac/Explore-v1", disable_env_checker=True).unwrapped
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    env.step(action)
    expected = env.state_hash()
    env.reset(seed=1)
    env.scene.after_ipc_step = lambda: signal.raise_signal(signal.SIGINT)
    with pytest.raises(Stopped):
        env.step(action)
    assert env.state_hash() == expected
