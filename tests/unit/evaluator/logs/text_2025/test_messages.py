import contextlib
import io
from collections.abc import Callable
from datetime import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.logs.text_2025.messages import (
    MAX_LINE_BYTES,
    MAX_LOG_BYTES,
    NO_TRAINING,
    LoggedMessage,
    TextLogRejected,
    is_text_log,
    messages,
    number,
    printed_dict,
    vector,
    whole_number,
)

LINE = "2025-01-01 10:00:00.123 | INFO     | __main__:evaluate_policy:111 - "
ANY = LoggedMessage(line=7, time=datetime(2025, 1, 1), text="")


def read(text: str | bytes) -> list[LoggedMessage]:
    return list(messages(io.BytesIO(text.encode() if isinstance(text, str) else text)))


def test_message_has_its_line_time_and_text() -> None:
    first, second = read(f"{LINE}#KEY: deg\n{LINE}two\n")
    assert (first.line, first.text, second.line, second.text) == (1, "#KEY: deg", 2, "two")
    assert first.time == datetime(2025, 1, 1, 10, 0, 0, 123000)


def test_lines_without_prefix_belong_to_the_message_before() -> None:
    first, second = read(f"{LINE}info: [1.\n   2.]\n\n{LINE}two\n")
    assert (first.text, second.line) == ("info: [1.\n   2.]\n", 4)


def test_hand_edited_first_line_with_blanks_is_read() -> None:
    assert read(f"   {LINE}#KEY: deg\n")[0].text == "#KEY: deg"


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        (LINE + "#KEY: deg\n", True),
        ("   " + LINE, True),
        (LINE.replace("INFO     ", "INFO "), True),
        ('{"episode": 1}\n', False),
        (LINE[:40], False),
        ("2025\n", False),
        ("", False),
        ("\x00\xff" + LINE, False),
    ],
)
def test_text_log_is_told_by_how_it_starts(start: str, expected: bool) -> None:
    assert is_text_log(start.encode("latin-1")) is expected


def test_windows_line_ends_are_read() -> None:
    assert [message.text for message in read(f"{LINE}a\r\n{LINE}b\r\n")] == ["a", "b"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\x00\xff\xfe\x80" * 50, "Line 1 is not UTF-8"),
        (b"\x7fELF\x00\x00", "Line 1 contains binary data"),
        (b"hello\n", "Line 1: expected `<date> <time>"),
        (LINE.encode() + b"a\n\xff\n", "Line 2 is not UTF-8"),
        (b"2025-13-41 10:00:00.123 | INFO     | a:b:1 - x\n", "expected a date and time, got 2025-13-41"),
        (LINE.encode() + b"a\n" + b"b" * (MAX_LINE_BYTES + 1), "Line 2: expected at most"),
        (LINE.encode() + b"a\n" + (b"b" * 99_999 + b"\n") * 3, "Line 4: expected a message of at most"),
    ],
)
def test_what_is_no_text_log_is_refused_by_line(content: bytes, message: str) -> None:
    with pytest.raises(TextLogRejected, match=message):
        read(content)


def test_lines_and_files_may_be_as_large_as_the_limits() -> None:
    line = LINE.encode().ljust(262_143, b"x") + b"\n"
    assert [message.line for message in read(line * 32)] == list(range(1, 33))
    sentence = "expected at most 262144 bytes a line and 8388608 in all, got more."
    for content, refused_at in ((line * 32 + b"x", 33), (line[:-1] + b"x\n", 1)):
        with pytest.raises(TextLogRejected) as refused:
            read(content)
        assert (str(refused.value), refused.value.line) == (f"Line {refused_at}: {sentence}", refused_at)


def test_a_message_may_be_as_long_as_the_limit() -> None:
    first = LINE.ljust(100_000, "x")
    whole = f"{first}\n{'y' * 100_000}\n{'z' * 62_142}"
    (message,) = read(whole + "\n")
    assert len(message.text) == 262_144 - len(LINE)
    with pytest.raises(TextLogRejected) as refused:
        read(whole + "z\n")
    assert str(refused.value) == "Line 3: expected a message of at most 262144 characters, got more."
    assert refused.value.line == 3
    assert len(read(f"{whole}\n{whole}\n")) == 2, "each message is counted from its own start"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "Line 1: the file is empty."),
        (
            b"2025-13-41 10:00:00.123 | INFO     | a:b:1 - x\n",
            "Line 1: expected a date and time, got 2025-13-41 10:00:00.123.",
        ),
        (b"hello\n", "Line 1: expected `<date> <time> | INFO | ...`, got 'hello'."),
        *(
            (start, f"Line 1: expected `<date> <time> | INFO | ...`, got {start.decode().strip()!r}. {NO_TRAINING}")
            for start in (b"-----------------------\n", b"Using cuda device\n", b"| rollout/ | |\n")
        ),
    ],
)
def test_a_refusal_names_its_line_once_for_readers_and_once_for_programs(content: bytes, sentence: str) -> None:
    with pytest.raises(TextLogRejected) as refused:
        read(content)
    assert (str(refused.value), refused.value.line) == (sentence, 1)


def test_endless_line_is_refused_early() -> None:
    class Endless(io.RawIOBase):
        given = 0

        def readable(self) -> bool:
            return True

        def readinto(self, buffer: Any) -> int:
            buffer[:] = b"x" * len(buffer)
            self.given += len(buffer)
            return len(buffer)

    endless = Endless()
    with pytest.raises(TextLogRejected) as refused:
        list(messages(io.BufferedReader(endless)))
    assert str(refused.value) == (
        f"Line 1: expected at most {MAX_LINE_BYTES} bytes a line and {MAX_LOG_BYTES} in all, got more."
    )
    assert endless.given < 4 * MAX_LINE_BYTES


@given(st.binary(max_size=300))
def test_junk_is_refused_or_read_but_never_crashes(junk: bytes) -> None:
    with contextlib.suppress(TextLogRejected):
        assert read(LINE.encode() + junk)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("[-4. -4. -8.]", (-4, -4, -8)),
        ("[1.5 -2.25]", (1.5, -2.25)),
        ("[ 1.5e-3\n  2. ]", (0.0015, 2)),
        ("[]", ()),
    ],
)
def test_vector_reads_printed_arrays(text: str, values: tuple[float, ...]) -> None:
    assert vector(ANY, text) == values


@pytest.mark.parametrize("text", ["[nan 1.]", "[1. inf]", "1. 2.", "[1. two]", "[1. 2.", "[1.,2.]"])
def test_vector_refuses_anything_else(text: str) -> None:
    with pytest.raises(TextLogRejected, match="Line 7: "):
        vector(ANY, text)


@pytest.mark.parametrize("text", ["nan", "-inf", "1e999", "x", ""])
def test_number_must_be_finite(text: str) -> None:
    with pytest.raises(TextLogRejected, match="number"):
        number(ANY, text)


@pytest.mark.parametrize("read_value", [vector, number, whole_number])
def test_a_refusal_escapes_what_it_quotes(read_value: Callable[[LoggedMessage, str], object]) -> None:
    with pytest.raises(TextLogRejected) as refused:
        read_value(ANY, "\x1b[2J" + "x" * 1000)
    assert "\\x1b[2J" in str(refused.value)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 120


def test_file_larger_than_any_true_log_is_refused() -> None:
    lines = LINE.encode() + b"x" * (MAX_LINE_BYTES - 100) + b"\n"
    with pytest.raises(TextLogRejected, match="expected at most"):
        read(lines * (MAX_LOG_BYTES // len(lines) + 1))


@pytest.mark.parametrize("text", ["-1", "1.5", "9" * 10, "9" * 5000])
def test_count_is_a_short_number(text: str) -> None:
    with pytest.raises(TextLogRejected) as refused:
        whole_number(ANY, text)
    assert str(refused.value) == f"Line 7: expected a count of at most nine digits, got {text!r:.60}."


def test_printed_dict_reads_python_and_numpy_values() -> None:
    text = (
        "{'steps': 1, 'd': array([1e-3, -2.]), 'z': array([0.5,\n  1. ],\n dtype=float32), 'ok': False, "
        + "'n': {'a': None}}"
    )
    assert printed_dict(ANY, text) == {
        "steps": 1, "d": (0.001, -2.0), "z": (0.5, 1.0), "ok": False, "n": {"a": None},
    }  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "{'a': nan}",
        "{'a': 1e999}",
        "{'a': array([inf])}",
        "{'a': __import__('os').system('true')}",
        "{'a': 1, 'a': 2}",
        "{**{'a': 1}}",
        "{1: 2}",
        "[1, 2]",
        "{'a': 2 ** 99999}",
        "{'a': lambda: 1}",
        "{" * 5000,
        "[" * 150 + "]" * 150,
        "{'a': -'b'}",
        "{'a': 1j}",
        "{'a': " + "9" * 400 + "}",
        "{'a': -" + "9" * 400 + "}",
        "{{}: 1}",
        "",
    ],
)
def test_printed_dict_refuses_anything_else(text: str) -> None:
    with pytest.raises(TextLogRejected, match="Line 7: "):
        printed_dict(ANY, text)
