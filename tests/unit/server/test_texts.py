import pytest
from submission_steps import refused
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.names import TEXT_LENGTH, clean_text


def test_lines_and_paragraphs_stay_and_ends_of_lines_go() -> None:
    assert clean_text(" \r\n a \tb  \r\n\r\n  c\n ", what="A text") == "a \tb\n\n  c"
    assert clean_text("x" * TEXT_LENGTH, what="A text") == "x" * TEXT_LENGTH


@pytest.mark.parametrize(
    "text", ["", " \n ", "x", "x" * (TEXT_LENGTH + 1), "a\0b", "a\x1bb", "turned \u202e around", "a\u2028b"]
)
def test_a_text_is_plain_and_bounded(text: str) -> None:
    with refused(ProblemCode.INVALID_REQUEST):
        clean_text(text, what="A text")


def test_the_refusal_says_what_was_expected_and_got() -> None:
    with pytest.raises(ServiceError, match=r"^A ruling has 2 to 4000 printable characters; got 1: 'x'"):
        clean_text(" x ", what="A ruling")
