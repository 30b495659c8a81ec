import os
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.agent.isolation.output import OutputTail, printable


@pytest.fixture
def pipe() -> Iterator[tuple[OutputTail, int]]:
    read, write = os.pipe()
    tail = OutputTail(read, kept_bytes=100)
    yield tail, write
    tail.close()
    os.close(write)


def test_keeps_the_end_and_counts_all(pipe: tuple[OutputTail, int]) -> None:
    tail, write = pipe
    os.write(write, b"a" * 500 + b"end")
    tail.read_available()
    assert tail.counted_bytes == 503
    assert tail.text() == "a" * 97 + "end"


def test_reading_nothing_does_not_wait(pipe: tuple[OutputTail, int]) -> None:
    tail, _ = pipe
    tail.read_available()
    assert (tail.counted_bytes, tail.is_closed) == (0, False)


def test_a_flood_does_not_hold_the_reader(pipe: tuple[OutputTail, int]) -> None:
    tail, write = pipe
    os.write(write, b"x" * 60_000)
    tail.read_available(max_bytes=1)
    assert tail.counted_bytes > 0


def test_restart_forgets_an_earlier_episode(pipe: tuple[OutputTail, int]) -> None:
    tail, write = pipe
    os.write(write, b"earlier")
    tail.restart_count()
    os.write(write, b"now")
    tail.read_available()
    assert (tail.text(), tail.counted_bytes) == ("now", 3)


def test_knows_when_every_writer_has_gone() -> None:
    read, write = os.pipe()
    tail = OutputTail(read, kept_bytes=10)
    os.close(write)
    tail.read_available()
    assert tail.is_closed
    tail.close()
    tail.close()


def test_text_is_safe_for_a_terminal() -> None:
    assert printable("a\x1b[31m\r\nb\x07\u202e\tc") == "a\N{REPLACEMENT CHARACTER}[31m\nb" + (
        "\N{REPLACEMENT CHARACTER}" * 2 + "\tc"
    )


@given(st.binary(max_size=300))
def test_any_bytes_become_printable_text(data: bytes) -> None:
    text = printable(data.decode("utf-8", "replace"))
    assert all(character.isprintable() or character in "\n\t" for character in text)
