from dataclasses import FrozenInstanceError, fields

import pytest
from vitac.evaluator.agent.limits import GIB, KIB, MIB, Limits, LimitsInvalid


def test_defaults_are_the_published_ones() -> None:
    limits = Limits()
    assert (limits.memory_bytes, limits.address_space_bytes, limits.processes) == (3 * GIB, 4 * GIB, 64)
    assert (limits.action_cpu_s, limits.action_wall_s, limits.episode_cpu_s) == (2, 10, 30)
    assert (limits.start_cpu_s, limits.start_wall_s) == (60, 120)
    assert (limits.output_kept_bytes, limits.output_killed_bytes) == (64 * KIB, 4 * MIB)
    assert (limits.archive_packed_bytes, limits.archive_unpacked_bytes) == (512 * MIB, GIB)


@pytest.mark.parametrize("name", [field.name for field in fields(Limits)])
@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_limits_must_be_above_zero(name: str, value: float) -> None:
    with pytest.raises(LimitsInvalid, match=name):
        Limits(**{name: value})  # type: ignore[arg-type]


def test_limits_do_not_change() -> None:
    with pytest.raises(FrozenInstanceError):
        Limits().processes = 1  # type: ignore[misc]
