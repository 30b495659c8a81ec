"""What the service shows of a log that earns no score; everything recorded is hostile."""

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import JsonValue
from vitac.evaluator.logs.findings import (
    Divergence,
    Impossibility,
    ImpossibleReason,
    LogFinding,
    VerificationResult,
    comparable,
)

DIVERGENCE = Divergence(
    episode=4,
    env_step=2,
    recorded_state="a" * 64,
    recorded_info={"steps": 2},
    resimulated_state="b" * 64,
    resimulated_info={"steps": 2},
)
SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=200)
VALUES: st.SearchStrategy[JsonValue] = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
)


def leaves(value: JsonValue) -> Iterator[JsonValue]:
    if isinstance(value, dict):
        for inner in value.values():
            yield from leaves(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from leaves(inner)
    else:
        yield value


def has_the_form_of(value: JsonValue, ours: JsonValue) -> bool:
    if value is None:
        return True
    if isinstance(ours, dict):
        same_keys = isinstance(value, dict) and list(value) == list(ours)
        return same_keys and all(has_the_form_of(value[key], ours[key]) for key in ours)  # type: ignore[index,call-overload]
    if isinstance(ours, list):
        same_length = isinstance(value, list) and len(value) == len(ours)
        return same_length and all(map(has_the_form_of, value, ours))  # type: ignore[arg-type]
    return not isinstance(value, dict | list)


def test_a_divergence_is_told_with_its_place() -> None:
    finding = LogFinding.diverged(DIVERGENCE)
    assert (finding.verdict, finding.episode) == (VerificationResult.DIVERGED, 4)
    assert finding.reason == "diverged at episode 4, env step 2"
    assert (finding.divergence, finding.impossibility) == (DIVERGENCE, None)


@pytest.mark.parametrize("episode", [7, None])
def test_an_impossibility_is_told_in_its_own_words(episode: int | None) -> None:
    why = Impossibility(reason=ImpossibleReason.OTHER_TASK, message="Episode 7 is of another task.", episode=episode)
    finding = LogFinding.impossible(why)
    assert (finding.verdict, finding.reason) == (VerificationResult.IMPOSSIBLE, "Episode 7 is of another task.")
    assert (finding.episode, finding.impossibility, finding.divergence) == (episode, why, None)


def test_a_finding_without_a_place_concerns_the_whole_log() -> None:
    assert LogFinding(verdict=VerificationResult.DIVERGED, reason="other states").episode is None


def test_a_finding_survives_its_way_through_json() -> None:
    finding = LogFinding.diverged(DIVERGENCE)
    assert LogFinding.model_validate_json(finding.model_dump_json()) == finding


@given(VALUES)
def test_a_value_of_our_own_is_shown_whole_but_for_long_or_steering_texts(ours: JsonValue) -> None:
    shown = list(leaves(comparable(ours, ours)))
    for before, after in zip(leaves(ours), shown, strict=True):
        hidden = isinstance(before, str) and (len(before) > 100 or not before.isprintable())
        assert after == (None if hidden else before)


@given(VALUES, VALUES)
def test_whatever_is_recorded_only_what_has_our_form_is_shown(recorded: JsonValue, ours: JsonValue) -> None:
    shown = comparable(recorded, ours)
    assert has_the_form_of(shown, ours)
    for value in leaves(shown):
        assert not isinstance(value, str) or (len(value) <= 100 and value.isprintable())


@pytest.mark.parametrize(
    ("recorded", "ours", "shown"),
    [
        ({"a": 1, "extra": "<script>"}, {"a": 2.5}, {"a": 1}),
        ({"extra": 1}, {"a": 2}, {"a": None}),
        ([1, 2, 3], [1, 2], None),
        ([1, "\x1b[2J"], [1, "text"], [1, None]),
        (True, 1, None),
        (1, True, None),
        (False, True, False),
        ("x" * 100, "text", "x" * 100),
        ("x" * 101, "text", None),
        ("text", 5, None),
        ("text", None, "text"),
        (5, None, None),
    ],
)
def test_examples_of_what_is_shown(recorded: JsonValue, ours: JsonValue, shown: JsonValue) -> None:
    assert comparable(recorded, ours) == shown


def test_results_and_reasons_are_the_words_that_the_api_and_stored_findings_hold() -> None:
    assert {result.value for result in VerificationResult} >= {
        "verified",
        "verified within tolerance",
        "diverged",
        "impossible",
    }
    assert all(reason.value == reason.name.lower() for reason in ImpossibleReason)
    assert {reason.value for reason in ImpossibleReason} >= {
        "other_evaluation",
        "other_task",
        "not_in_list",
        "other_start",
        "too_many_steps",
        "wrong_action",
        "episode_missing",
        "broken_policy",
    }


@pytest.mark.parametrize(("recorded", "ours"), [("text", [1]), (5, [1]), (None, [1]), ({"a": 1}, [1]), ([1], {"a": 1})])
def test_a_value_of_another_structure_is_not_shown(recorded: JsonValue, ours: JsonValue) -> None:
    assert comparable(recorded, ours) is None
