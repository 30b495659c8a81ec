"""Tables of transitions: closed, with ends that are final, and a way to an end from everywhere."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import pytest
from vitac.server.database.states import (
    ACTIVE_EVALUATION_STATES,
    EVALUATION_TRANSITIONS,
    OPEN_WORK_STATES,
    TERMINAL_EVALUATION_STATES,
    WORK_TRANSITIONS,
    EvaluationState,
    WorkState,
)

Table = Mapping[Any, frozenset[Any]]
TABLES: list[tuple[type[StrEnum], Table]] = [
    (EvaluationState, EVALUATION_TRANSITIONS),
    (WorkState, WORK_TRANSITIONS),
]
EACH = pytest.mark.parametrize(("states", "table"), TABLES, ids=[states.__name__ for states, _ in TABLES])


def reached(table: Table, state: Any) -> set[Any]:
    """All states that can follow a state, sooner or later."""
    found: set[Any] = set()
    waiting = [state]
    while waiting:
        following = table[waiting.pop()] - found
        found |= following
        waiting += following
    return found


@EACH
def test_every_state_has_a_row_of_states(states: type[StrEnum], table: Table) -> None:
    assert set(table) == set(states)
    assert all(following <= set(states) for following in table.values())


@EACH
def test_nothing_becomes_what_it_is(states: type[StrEnum], table: Table) -> None:
    assert not [state for state in states if state in table[state]]


@EACH
def test_an_end_is_reached_from_everywhere_and_is_final(states: type[StrEnum], table: Table) -> None:
    ends = {state for state in states if not table[state]}
    assert ends
    for state in set(states) - ends:
        assert reached(table, state) & ends


@EACH
def test_all_begins_in_the_queue(states: type[StrEnum], table: Table) -> None:
    queued = states("queued")
    assert reached(table, queued) | {queued} == set(states)


def test_an_evaluation_never_waits_again_and_is_scored_only_after_it_ran() -> None:
    assert EvaluationState.QUEUED not in reached(EVALUATION_TRANSITIONS, EvaluationState.QUEUED)
    assert EvaluationState.COMPLETED not in EVALUATION_TRANSITIONS[EvaluationState.QUEUED]


def test_what_a_worker_gives_back_waits_again() -> None:
    assert WorkState.QUEUED in WORK_TRANSITIONS[WorkState.RUNNING]


def test_open_and_ended_states_are_told_apart() -> None:
    assert {
        EvaluationState.COMPLETED,
        EvaluationState.FAILED,
        EvaluationState.CANCELLED,
    } == TERMINAL_EVALUATION_STATES
    assert {EvaluationState.QUEUED, EvaluationState.RUNNING} == ACTIVE_EVALUATION_STATES
    assert {WorkState.QUEUED, WorkState.RUNNING} == OPEN_WORK_STATES
