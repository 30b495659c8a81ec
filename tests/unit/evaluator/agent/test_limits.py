from dataclasses import fields

import pytest
from vitac.evaluator.agent.limits import Limits, LimitsInvalid


@pytest.mark.parametrize("name", [field.name for field in fields(Limits)])
@pytest.mark.parametrize("value", [0, -1, float("nan")])
def test_limits_must_be_above_zero(name: str, value: float) -> None:
    with pytest.raises(LimitsInvalid, match=name):
        Limits(**{name: value})  # type: ignore[arg-type]
