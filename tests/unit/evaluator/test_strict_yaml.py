"""YAML is read as plain data: no key twice, and of untrusted documents no tags, aliases or large values."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.evaluator import tracks
from vitac.evaluator.strict_model import (
    UNTRUSTED_MAX_DEPTH,
    UNTRUSTED_MAX_NODES,
    Ambiguous,
    UniqueKeyLoader,
    UntrustedLoader,
)

BOTH = pytest.mark.parametrize("loader", [UniqueKeyLoader, UntrustedLoader])
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-1000, 1000) | st.text("abc: -#'\"", max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc", max_size=3), inner, max_size=3),
    max_leaves=8,
)


OWN_DOCUMENTS = sorted(Path(tracks.__file__).parent.glob("*.yaml"))


def load(text: str, loader: type[UniqueKeyLoader | UntrustedLoader]) -> Any:
    return yaml.load(text, Loader=loader)  # noqa: S506 - both derive from SafeLoader


@BOTH
@settings(max_examples=25)
@given(value=PLAIN)
def test_plain_values_are_read_as_they_were_written(
    loader: type[UniqueKeyLoader | UntrustedLoader], value: object
) -> None:
    assert load(yaml.safe_dump({"value": value}), loader) == {"value": value}


@BOTH
@pytest.mark.parametrize("text", ["a: 1\na: 1", "a: 1\n'a': 2", "x: {a: 1, a: 2}", "1: a\n1: b", "[{b: 1, b: 2}]"])
def test_a_key_twice_is_refused(loader: type[UniqueKeyLoader | UntrustedLoader], text: str) -> None:
    with pytest.raises(yaml.YAMLError, match="is given twice"):
        load(text, loader)


@BOTH
def test_a_long_key_is_cut_in_the_message(loader: type[UniqueKeyLoader | UntrustedLoader]) -> None:
    key = "k" * 500
    with pytest.raises(yaml.YAMLError) as refused:
        load(f"{key}: 1\n{key}: 2", loader)
    assert f"key '{'k' * 80}' is given twice" in str(refused.value)


@BOTH
@pytest.mark.parametrize("text", ["? [a, b]\n: 1", "? {a: 1}\n: 1"])
def test_a_key_is_text(loader: type[UniqueKeyLoader | UntrustedLoader], text: str) -> None:
    with pytest.raises(yaml.YAMLError, match="a key must be text, expected no list or mapping"):
        load(text, loader)


@BOTH
def test_what_only_looks_like_a_number_is_a_yaml_error(loader: type[UniqueKeyLoader | UntrustedLoader]) -> None:
    with pytest.raises(yaml.YAMLError, match="'0b_' looks like a number, but is none; put it in quotes"):
        load("number: 0b_", loader)


@BOTH
@pytest.mark.parametrize("text", ["12:30", "010", "-07", "1:30:15", "12:30.5"])
def test_what_programs_read_in_different_ways_is_neither_a_number_nor_text(
    loader: type[UniqueKeyLoader | UntrustedLoader], text: str
) -> None:
    assert load(f"value: {text}", loader) == {"value": Ambiguous(text)}


@pytest.mark.parametrize("text", ["2025-99-99", "2025-03-01T99:00:00", "2025-03-01"])
def test_dates_are_text(text: str) -> None:
    assert load(f"day: {text}", UniqueKeyLoader) == {"day": text}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2025-03-01", "2025-03-01"),
        ("2025-03-01T12:00:00Z", "2025-03-01T12:00:00Z"),
        ("<<", "<<"),
        ("yes", True),
        ("~", None),
        ("1_000", 1000),
        ("1.5", 1.5),
        (".inf", float("inf")),
        ("'17'", "17"),
    ],
)
def test_an_untrusted_scalar_is_text_a_number_a_truth_or_nothing(text: str, value: object) -> None:
    assert load(f"value: {text}", UntrustedLoader) == {"value": value}


def test_a_mapping_of_our_own_may_take_the_keys_of_another_and_replace_some() -> None:
    text = "a: &one {x: 1, y: 2}\nb: {<<: *one, y: 3}"
    assert load(text, UniqueKeyLoader)["b"] == {"x": 1, "y": 3}


def test_a_document_of_our_own_may_have_aliases_and_an_untrusted_one_may_not() -> None:
    text = "a: &one [1, 2]\nb: *one"
    assert load(text, UniqueKeyLoader) == {"a": [1, 2], "b": [1, 2]}
    for part in (text, "a: &one 1", "b: *one"):
        with pytest.raises(yaml.YAMLError, match=r"anchors \(&\) and aliases \(\*\) are not allowed"):
            load(part, UntrustedLoader)


@pytest.mark.parametrize("text", ["!!python/object:os.system x", "!!str 5", "a: !own 1", "!!set {a, b}", "[!!int '5']"])
def test_an_untrusted_document_has_no_tags(text: str) -> None:
    with pytest.raises(yaml.YAMLError, match=r"tags \(!\) are not allowed; write plain values"):
        load(text, UntrustedLoader)


def test_no_document_calls_python() -> None:
    with pytest.raises(yaml.YAMLError, match="could not determine a constructor"):
        load("!!python/object/apply:os.getcwd []", UniqueKeyLoader)


def test_an_untrusted_document_may_have_as_many_values_as_allowed_and_no_more() -> None:
    # The list counts, too.
    assert len(load(f"[{'1,' * (UNTRUSTED_MAX_NODES - 1)}]", UntrustedLoader)) == UNTRUSTED_MAX_NODES - 1
    with pytest.raises(yaml.YAMLError, match=f"more than {UNTRUSTED_MAX_NODES} values"):
        load(f"[{'1,' * UNTRUSTED_MAX_NODES}]", UntrustedLoader)
    assert len(load(f"[{'1,' * UNTRUSTED_MAX_NODES}]", UniqueKeyLoader)) == UNTRUSTED_MAX_NODES


def test_an_untrusted_document_may_be_as_deep_as_allowed_and_no_deeper() -> None:
    def nested(depth: int) -> str:
        return "[" * depth + "]" * depth

    assert load(nested(UNTRUSTED_MAX_DEPTH), UntrustedLoader) is not None
    with pytest.raises(yaml.YAMLError, match=f"values are nested more than {UNTRUSTED_MAX_DEPTH} deep"):
        load(nested(UNTRUSTED_MAX_DEPTH + 1), UntrustedLoader)


def test_depth_is_counted_along_one_branch() -> None:
    branch = "[" * (UNTRUSTED_MAX_DEPTH - 1) + "]" * (UNTRUSTED_MAX_DEPTH - 1)
    assert len(load(f"[{', '.join([branch] * 5)}]", UntrustedLoader)) == 5


def test_the_fast_reader_finds_in_our_documents_what_the_slow_one_does() -> None:
    assert OWN_DOCUMENTS
    for file in OWN_DOCUMENTS:
        text = file.read_text(encoding="utf-8")
        assert load(text, UniqueKeyLoader) == yaml.safe_load(text), file.name


@pytest.mark.skipif(not yaml.__with_libyaml__, reason="PyYAML has no libyaml here")
def test_documents_of_our_own_are_read_by_libyaml_and_untrusted_ones_by_what_counts_their_values() -> None:
    assert issubclass(UniqueKeyLoader, yaml.CSafeLoader)
    assert not issubclass(UntrustedLoader, yaml.CSafeLoader)


@BOTH
@pytest.mark.parametrize("text", ["a: [1", "a: 1\n\tb: 2", "a: 'b", "- a\nb: 1", "a: b: c"])
def test_what_is_no_yaml_is_refused_with_its_line(loader: type[UniqueKeyLoader | UntrustedLoader], text: str) -> None:
    with pytest.raises(yaml.YAMLError, match=r"line [12], column"):
        load(text, loader)
