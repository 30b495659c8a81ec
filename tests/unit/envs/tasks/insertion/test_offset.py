from math import isclose

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.tasks.fusion_insertion.variation import FusionOffset
from vitac.envs.tasks.insertion.offset import PegOffset, is_beyond

NUMBERS = st.floats(-50.0, 50.0)


@given(x_mm=NUMBERS, y_mm=NUMBERS, theta_deg=NUMBERS, z_mm=NUMBERS)
def test_every_number_of_an_offset_counts_in_its_array_and_magnitude(
    x_mm: float, y_mm: float, theta_deg: float, z_mm: float
) -> None:
    flat = PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)
    high = FusionOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg, z_mm=z_mm)
    assert flat.as_array().tolist() == [x_mm, y_mm, theta_deg]
    assert high.as_array().tolist() == [x_mm, y_mm, theta_deg, z_mm]
    for offset in (flat, high):
        assert isclose(offset.magnitude(), float(np.linalg.norm(offset.as_array())), abs_tol=1e-12)


@pytest.mark.parametrize(("value", "beyond"), [(12.0, False), (12.000009, False), (12.00002, True), (11.0, False)])
def test_limit_holds_either_way_and_is_itself_allowed(value: float, beyond: bool) -> None:
    assert is_beyond(value, 12.0) is beyond
    assert is_beyond(-value, 12.0) is beyond
