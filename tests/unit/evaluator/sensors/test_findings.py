"""Findings and limits of a team's sensor: every rule has a name that stays, every limit leaves room."""

import pytest
from vitac.evaluator.sensors.findings import Finding, Rule, sensor_limits


@pytest.mark.parametrize("rule", Rule)
def test_a_rule_is_named_after_itself(rule: Rule) -> None:
    assert rule.value == rule.name.lower()


@pytest.mark.parametrize(
    ("value_mm", "ok", "text"),
    [(0.0, True, "0.000 mm"), (0.1, True, "0.100 mm"), (0.10001, False, "0.100 mm"), (2.5, False, "2.500 mm")],
)
def test_a_length_may_reach_its_limit(value_mm: float, ok: bool, text: str) -> None:
    found = Finding.limit_length(Rule.DISTANCE, value_mm, 0.1, "Mesh it again.")
    assert found == Finding(rule=Rule.DISTANCE, ok=ok, value=text, limit="at most 0.1 mm", problem="Mesh it again.")


def test_a_finding_needs_no_advice() -> None:
    assert Finding(rule=Rule.READABLE, ok=True, value="STL", limit="an STL file").problem == ""


def test_limits_leave_room_for_a_gel() -> None:
    limits = sensor_limits()
    assert limits.min_thickness_mm < limits.max_thickness_mm
    assert limits.min_nodes <= limits.wanted_nodes <= limits.max_nodes
    assert limits.base_tolerance_mm < limits.max_distance_mm < limits.min_thickness_mm
    assert limits.base_tolerance_mm < min(limits.base_length_mm, limits.base_width_mm)


def test_limits_are_read_once() -> None:
    assert sensor_limits() is sensor_limits()
