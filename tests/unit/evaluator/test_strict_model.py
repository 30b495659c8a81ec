"""What is wrong with a file is said in short sentences, with the nearest valid key."""

from pathlib import Path
from typing import Literal, Self

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError, field_validator, model_validator
from vitac.evaluator.strict_model import (
    DocumentRejected,
    StrictModel,
    Word,
    explain,
    parse_untrusted_yaml,
    parse_yaml,
    read_yaml,
    validate,
)


class Lens(StrictModel):
    focal_length: float
    coating: Literal["none", "matt"] = "none"


class Camera(StrictModel):
    name: Word
    width: int = 640
    lens: Lens | None = None
    spare: tuple[Lens, ...] = ()
    by_side: dict[str, Lens] = Field(default_factory=dict)


def refused(content: object) -> str:
    with pytest.raises(DocumentRejected) as rejection:
        validate(Camera, content, "camera.yaml")
    message = str(rejection.value)
    assert message.startswith("camera.yaml: ")
    return message.removeprefix("camera.yaml: ")


def test_a_document_becomes_a_model() -> None:
    text = "name: rig\nlens: {focal_length: 2.5, coating: matt}\n"
    for parse in (parse_yaml, parse_untrusted_yaml):
        assert parse(Camera, text, "camera.yaml") == Camera(name="rig", lens=Lens(focal_length=2.5, coating="matt"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"name": "a", "widht": 1}, "Unknown key 'widht'; did you mean 'width'?"),
        ({"name": "a", "zoom": 1}, "Unknown key 'zoom'; valid keys are by_side, lens, name, spare, width."),
        (
            {"name": "a", "lens": {"focal_length": 1, "coatin": "matt"}},
            "Unknown key 'lens.coatin'; did you mean 'coating'?",
        ),
        (
            {"name": "a", "spare": [{"focal_length": 1, "focal_lenght": 1}]},
            "Unknown key 'spare.0.focal_lenght'; did you mean 'focal_length'?",
        ),
        (
            {"name": "a", "by_side": {"left": {"focal_length": 1, "coat": 1}}},
            "Unknown key 'by_side.left.coat'; did you mean 'coating'?",
        ),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_of_its_place(content: object, message: str) -> None:
    assert refused(content) == message


def test_a_rule_of_ours_is_told_in_its_own_words() -> None:
    class Ruled(StrictModel):
        width: int

        @model_validator(mode="after")
        def _is_even(self) -> Self:
            raise ValueError("expected an even width")

    with pytest.raises(DocumentRejected, match=r"^rig\.yaml: the document: expected an even width\.$"):
        validate(Ruled, {"width": 1}, "rig.yaml")


def test_a_missing_key_is_named_with_its_place() -> None:
    assert refused({"name": "a", "lens": {}}) == "Missing key 'lens.focal_length'; add it."


def test_a_wrong_value_is_shown() -> None:
    assert refused({"name": "a", "width": "wide"}).endswith("(got: 'wide').")
    assert refused({"name": "a", "width": None}).endswith("(got: None).")
    assert refused({"name": "a", "lens": {"focal_length": True, "coating": "blue"}}).endswith("(got: 'blue').")


def test_what_is_no_mapping_is_refused_as_a_whole() -> None:
    assert refused([1, 2]) == "Expected a document with the keys name, got list."


def test_an_empty_document_is_called_empty() -> None:
    for text in ("", "# nothing but a comment"):
        with pytest.raises(DocumentRejected, match=r"^cup\.yaml is empty, expected a document with the keys name"):
            parse_yaml(Camera, text, "cup.yaml")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_is_none_is_refused(value: float) -> None:
    assert "finite" in refused({"name": "a", "lens": {"focal_length": value}})


@pytest.mark.parametrize("name", ["", "two words", "\x1b[2J", "a\n", "x" * 101, "<b>", "é" * 101])
def test_a_word_cannot_steer_a_terminal(name: str) -> None:
    with pytest.raises(DocumentRejected):
        validate(Camera, {"name": name}, "camera.yaml")


@pytest.mark.parametrize("name", ["a", "x" * 100, "1.2+3:4-5_6", "Übung"])
def test_a_word_may_be_a_name_or_version(name: str) -> None:
    assert validate(Camera, {"name": name}, "camera.yaml").name == name


def test_five_problems_are_told_and_the_rest_is_counted() -> None:
    message = refused({"name": "a"} | {f"key{number}": 1 for number in range(7)})
    assert message.count("Unknown key") == 5
    assert message.endswith(" And 2 more.")
    assert "more" not in refused({"name": "a"} | {f"key{number}": 1 for number in range(5)}).rpartition(".")[0]


@given(st.dictionaries(st.text(max_size=300), st.integers() | st.text(max_size=500) | st.lists(st.integers())))
def test_a_message_is_short_whatever_is_in_a_document(content: dict[str, object]) -> None:
    with pytest.raises(ValidationError) as found:
        Camera.model_validate({**content, "name": ""})
    assert 0 < len(explain(Camera, found.value)) < 2500


def test_a_huge_integer_is_counted_in_bits() -> None:
    message = refused({"name": "a", "lens": {"focal_length": 1, "coating": 1 << 20_000}})
    assert message.endswith("(got: an integer of 20001 bits).")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("name: [", "camera.yaml is not valid YAML: "),
        ("name: a\nname: b", "camera.yaml is not valid YAML: "),
        ("- &a [*a]\n- *b", "camera.yaml is not valid YAML: "),
        ("!!python/object:os.system {}", "camera.yaml is not valid YAML: "),
        ("\x00", "camera.yaml is not valid YAML: "),
        ("", "camera.yaml is empty, expected a document with the keys name"),
    ],
)
def test_text_that_is_no_document_is_refused_in_one_line(text: str, reason: str) -> None:
    for parse in (parse_yaml, parse_untrusted_yaml):
        with pytest.raises(DocumentRejected) as rejection:
            parse(Camera, text, "camera.yaml")
        assert str(rejection.value).startswith(reason)
        assert "\n" not in str(rejection.value)


def test_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text("name: left")
    assert read_yaml(Camera, path).name == "left"
    path.write_bytes(b"name: \xff")
    for file, reason in ((path, "can't decode byte 0xff"), (tmp_path, "Is a directory"), (tmp_path / "a", "No such")):
        with pytest.raises(DocumentRejected, match=f"{file} cannot be read: .*{reason}"):
            read_yaml(Camera, file)


@pytest.mark.parametrize("text", ["name: !!str a", "name: &a a\nwidth: *a", "name: !!python/object:os.system a"])
def test_untrusted_text_has_neither_tags_nor_anchors(text: str) -> None:
    with pytest.raises(DocumentRejected, match=r"camera\.yaml is not valid YAML"):
        parse_untrusted_yaml(Camera, text, "camera.yaml")


def test_a_record_cannot_be_changed() -> None:
    camera = Camera(name="rig")
    with pytest.raises(ValidationError):
        camera.name = "other"


class Even(StrictModel):
    """A record with a rule of its own."""

    number: int

    @field_validator("number")
    @classmethod
    def _is_even(cls, value: int) -> int:
        if value % 2:
            raise ValueError(f"{value} is odd; give an even one.")
        return value


def test_what_our_own_rules_say_is_told_without_a_prefix_and_ends_once() -> None:
    with pytest.raises(DocumentRejected) as refused:
        validate(Even, {"number": 3}, "even.yaml")
    assert str(refused.value) == "even.yaml: number: 3 is odd; give an even one (got: 3)."
    assert validate(Even, {"number": 4}, "even.yaml").number == 4
