from math import radians

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.tasks.insertion.guided_motion import way_to_the_hole


@given(x_mm=st.floats(-12.0, 12.0), y_mm=st.floats(-30.0, 30.0), theta_deg=st.floats(-20.0, 20.0))
def test_way_ends_at_the_hole_whatever_the_angle(x_mm: float, y_mm: float, theta_deg: float) -> None:
    along, across, turn = way_to_the_hole((x_mm, y_mm, theta_deg))
    angle = radians(theta_deg)
    world = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ [along, across]
    assert np.allclose(world + np.array([x_mm, y_mm]), 0.0, atol=1e-12)
    assert theta_deg + turn == 0.0
