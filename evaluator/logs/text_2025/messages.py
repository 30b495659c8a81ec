"""Splits a 2025 text log into messages and parses the Python values printed in them, without evaluating code."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from math import isfinite
from typing import Any, BinaryIO

from vitac.errors import VitacError

MAX_LINE_BYTES = 1 << 18
MAX_MESSAGE_CHARACTERS = 1 << 18
MAX_LOG_BYTES = 8 << 20
"""Limits on what is read; a real log has lines of up to 10,000 bytes and 5 MB in all."""

# `<date> <time>.<ms> | <LEVEL padded> | <module>:<function>:<line> - <message>`; the organizers' own log starts with
# stray blanks, so blanks before the date are accepted.
_PREFIX = re.compile(
    r"\s*(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}) \| ([A-Z]+) *\| ([\w.]+):([\w<>.]+):(\d+) - (.*)", re.DOTALL
)


NO_TRAINING = (
    "The log of a training is none: give the one that the evaluation script of 2025 writes (`evaluate_policy`), or "
    "upload the policy itself."
)
_OF_TRAINING = re.compile(
    r"^\W*-{10,}\W*$|rollout/|train/|eval/|ep_(len|rew)_mean|timesteps|device|[Ll]ogging to|[Ww]rapping|[Ll]earning",
)
"""What Stable-Baselines3 and those around it print while they learn."""


class TextLogRejected(VitacError):
    """The file is not a 2025 text log; the message names the line and the reason.

    Attributes:
        line: number of the line, from 1; None where it is the whole file.
    """

    def __init__(self, message: str, *, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True, kw_only=True)
class LoggedMessage:
    """One message; `line` counts from 1 and is that of its first line."""

    line: int
    time: datetime
    text: str


def is_text_log(start: bytes) -> bool:
    """Return whether a file with this start is one: its first line begins like a message."""
    return _PREFIX.match(start.decode("utf-8", "replace")) is not None


def messages(stream: BinaryIO) -> Iterator[LoggedMessage]:
    """Yield the messages of a log in order; a line without a prefix continues the message before it.

    Raises:
        TextLogRejected: it is not text, not a log, or larger than the limits.
    """
    first: tuple[int, re.Match[str]] | None = None
    text: list[str] = []
    length = 0
    for number, line in _lines(stream):
        match = _PREFIX.match(line)
        if match:
            if first:
                yield _message(*first, text)
            first, text, length = (number, match), [match[6]], len(line)
        elif first is None:
            raise TextLogRejected(
                f"Line {number}: expected `<date> <time> | INFO | ...`, got {line!r:.60}."
                f"{f' {NO_TRAINING}' if _OF_TRAINING.search(line) else ''}",
                line=number,
            )
        else:
            text.append(line)
            length += len(line) + 1
            if length > MAX_MESSAGE_CHARACTERS:
                raise TextLogRejected(
                    f"Line {number}: expected a message of at most {MAX_MESSAGE_CHARACTERS} characters, got more.",
                    line=number,
                )
    if first is None:
        raise TextLogRejected("Line 1: the file is empty.", line=1)
    yield _message(*first, text)


def vector(message: LoggedMessage, text: str) -> tuple[float, ...]:
    """Return the numbers of a printed NumPy array, `[-4. 0.5 2e-3]`.

    Raises:
        TextLogRejected: it is something else, or a number is not finite.
    """
    inside = text.strip()
    if not (inside.startswith("[") and inside.endswith("]")):
        raise _rejected(message, f"expected numbers in brackets, got {inside!r:.60}")
    return tuple(number(message, part) for part in inside[1:-1].split())


def number(message: LoggedMessage, text: str) -> float:
    """Return a finite number.

    Raises:
        TextLogRejected: it is something else.
    """
    try:
        value = float(text)
    except ValueError as error:
        raise _rejected(message, f"expected a number, got {text.strip()!r:.60}") from error
    if not isfinite(value):
        raise _rejected(message, f"expected a finite number, got {text.strip()!r:.60}")
    return value


def whole_number(message: LoggedMessage, text: str) -> int:
    """Return a number of at most nine digits.

    Raises:
        TextLogRejected: it is something else.
    """
    if not re.fullmatch(r"\d{1,9}", text):
        raise _rejected(message, f"expected a count of at most nine digits, got {text.strip()!r:.60}")
    return int(text)


def printed_dict(message: LoggedMessage, text: str) -> dict[str, Any]:
    """Return a printed Python dict of plain values and NumPy arrays; arrays become tuples.

    Raises:
        TextLogRejected: it is something else, or a number is not finite.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        value = _value(tree)
    except (SyntaxError, ValueError, TypeError, OverflowError, RecursionError, MemoryError) as error:
        raise _rejected(message, f"cannot read the printed values: {error!s:.80}") from error
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise _rejected(message, "expected a printed dict with text as keys")
    return value


def _value(node: ast.expr) -> Any:
    match node:
        case ast.Constant(value=bool() | str() | None):
            return node.value
        case ast.Constant(value=int() | float() as value) if isfinite(value):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float())):
            return -_value(node.operand)
        case ast.List() | ast.Tuple():
            return tuple(_value(element) for element in node.elts)
        case ast.Dict():
            keys = [_value(key) for key in node.keys if key is not None]
            if len(set(keys)) != len(node.values):
                raise ValueError("a key is repeated or missing")
            return dict(zip(keys, map(_value, node.values), strict=True))
        case ast.Call(func=ast.Name(id="array"), args=[ast.List() as elements]):
            return _value(elements)
        case _:
            raise ValueError(f"expected a plain finite value, got {ast.unparse(node):.40}")


def _lines(stream: BinaryIO) -> Iterator[tuple[int, str]]:
    number, total = 0, 0
    while line := stream.readline(MAX_LINE_BYTES + 1):
        number, total = number + 1, total + len(line)
        if len(line) > MAX_LINE_BYTES or total > MAX_LOG_BYTES:
            raise TextLogRejected(
                f"Line {number}: expected at most {MAX_LINE_BYTES} bytes a line and {MAX_LOG_BYTES} in all, got more.",
                line=number,
            )
        try:
            text = line.decode("utf-8")
        except UnicodeDecodeError as error:
            raise TextLogRejected(f"Line {number} is not UTF-8 text.", line=number) from error
        if "\x00" in text:
            raise TextLogRejected(f"Line {number} contains binary data.", line=number)
        yield number, text.rstrip("\r\n")


def _message(line: int, prefix: re.Match[str], text: list[str]) -> LoggedMessage:
    try:
        time = datetime.strptime(prefix[1], "%Y-%m-%d %H:%M:%S.%f")
    except ValueError as error:
        raise TextLogRejected(f"Line {line}: expected a date and time, got {prefix[1]}.", line=line) from error
    return LoggedMessage(line=line, time=time, text="\n".join(text))


def _rejected(message: LoggedMessage, reason: str) -> TextLogRejected:
    return TextLogRejected(f"Line {message.line}: {reason}.", line=message.line)
