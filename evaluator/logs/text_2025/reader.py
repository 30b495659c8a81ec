"""Reads the messages of a 2025 text log into header, episodes and totals; a misplaced line becomes a problem."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, BinaryIO

from .messages import NO_TRAINING, LoggedMessage, TextLogRejected, messages, number, printed_dict, vector, whole_number

MAX_PROBLEMS = 200
"""A file with more misplaced lines is refused as not a 2025 text log."""


@dataclass(kw_only=True)
class TextStep:
    """One env step. The lock's log has only the action; `ended` is the time of the next message."""

    line: int
    n: int
    action: tuple[float, ...]
    started: datetime
    ended: datetime | None = None
    offset: tuple[float, ...] | None = None
    info: dict[str, Any] = field(default_factory=dict)
    reward: float | None = None


@dataclass(kw_only=True)
class TextEpisode:
    """One test; `number` is the logged one."""

    line: int
    number: int
    started: datetime
    reset_ended: datetime | None = None
    initial_offset: tuple[float, ...] | None = None
    steps: list[TextStep] = field(default_factory=list)
    success: bool | None = None
    ended: datetime | None = None


@dataclass(kw_only=True)
class TextLog:
    """A whole log. `problems` are sentences about misplaced lines, `misplaced` their line numbers."""

    team: str | None = None
    script_md5: str | None = None
    git: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, str] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    episodes: list[TextEpisode] = field(default_factory=list)
    claimed_success_rate: float | None = None
    claimed_average_steps: float | None = None
    has_totals: bool = False
    problems: list[str] = field(default_factory=list)
    misplaced: list[int] = field(default_factory=list)


def read_text_log(stream: BinaryIO) -> TextLog:
    """Read a 2025 text log.

    Args:
        stream: the file, opened for reading bytes.

    Raises:
        TextLogRejected: it is not a 2025 text log.
    """
    reader = _Reader()
    for message in messages(stream):
        reader.take(message)
    if reader.log.team is None or not reader.log.environment:
        raise TextLogRejected(
            f"Line 1: expected a 2025 text log with `#KEY` and its environment; one of them is missing. {NO_TRAINING}",
            line=1,
        )
    return reader.log


class _Reader:
    """Adds one message after the other to a log."""

    def __init__(self) -> None:
        self.log = TextLog()
        self._last: LoggedMessage | None = None
        self._tests: set[int] = set()
        self._test_before = 0
        self._parts_of_step: set[str] = set()
        self._rules: list[tuple[re.Pattern[str], Callable[[LoggedMessage, re.Match[str]], None]]] = [
            (re.compile(pattern, re.DOTALL), rule)
            for pattern, rule in (
                (r"#KEY: (.*)", self._key),
                (r"this is MD5: ([0-9a-f]{32})\s*", self._md5),
                (r"Git Repository Information:\s*", lambda *_: None),
                (r" *(\w+): (.*)", self._git_or_part),
                (r"\n-+Parameters-+\n(.*)\n-+End-+\s*", self._parameters),
                (r"(\{.*\})\s*", self._environment),
                (r"#### Test No\. (\d+) ####\s*", self._test),
                (r"Initial offset: (.*)", self._initial_offset),
                (r"Step (\d+) Action: (.*)", self._action),
                (r"#SUCCESS_RATE: (?:(\d{1,3}\.\d\d)%|0|([01]\.\d{4}))\s*", self._success_rate),
                (r"#AVG_STEP: (?:(\d{1,4}\.\d\d)|NA)\s*", self._average_steps),
            )
        ]

    def take(self, message: LoggedMessage) -> None:
        """Add one message to the part of the log that it belongs to."""
        if self._last and message.time < self._last.time:
            self._problem(message, "its time is earlier than that of the line before")
        self._last = message
        for pattern, rule in self._rules:
            match = pattern.fullmatch(message.text)
            if match:
                rule(message, match)
                return
        self._problem(message, f"unknown message {message.text!r:.60}")

    def _key(self, message: LoggedMessage, match: re.Match[str]) -> None:
        if self.log.team is not None:
            self._problem(message, "a second log begins here")
            return
        if not match[1].isprintable():
            raise TextLogRejected(
                f"Line {message.line}: the team's name contains control characters.", line=message.line
            )
        self.log.team = match[1].strip()

    def _md5(self, _: LoggedMessage, match: re.Match[str]) -> None:
        self.log.script_md5 = self.log.script_md5 or match[1]

    def _git_or_part(self, message: LoggedMessage, match: re.Match[str]) -> None:
        parts = {"Offset": self._offset, "info": self._info, "Reward": self._reward, "RESULT": self._result}
        if match[1] in parts:
            parts[match[1]](message, match[2])
        elif not self.log.environment:
            self.log.git[match[1]] = match[2]
        else:
            self._problem(message, f"unknown message {message.text!r:.60}")

    def _parameters(self, _: LoggedMessage, match: re.Match[str]) -> None:
        lines = (line.partition(":") for line in match[1].splitlines())
        self.log.parameters = {name.strip(): value.strip() for name, _, value in lines}

    def _environment(self, message: LoggedMessage, match: re.Match[str]) -> None:
        self.log.environment = self.log.environment or printed_dict(message, match[1])

    def _test(self, message: LoggedMessage, match: re.Match[str]) -> None:
        test = whole_number(message, match[1])
        if self.log.episodes and self.log.episodes[-1].success is None:
            self._problem(message, f"test {self.log.episodes[-1].number} has no RESULT")
        if test in self._tests:
            self._problem(message, f"test {test} is repeated")
        elif test != self._test_before + 1:
            self._problem(message, f"expected test {self._test_before + 1}, got test {test}")
        self._test_before = test
        self._tests.add(test)
        self.log.episodes.append(TextEpisode(line=message.line, number=test, started=message.time))

    def _initial_offset(self, message: LoggedMessage, match: re.Match[str]) -> None:
        episode = self._open_episode(message)
        if episode and not episode.steps and episode.initial_offset is None:
            episode.initial_offset = vector(message, match[1])
            episode.reset_ended = message.time
        elif episode:
            self._problem(message, "an initial offset inside a test")

    def _action(self, message: LoggedMessage, match: re.Match[str]) -> None:
        episode = self._open_episode(message)
        if not episode:
            return
        self._end_step(episode, message)
        self._parts_of_step.clear()
        episode.reset_ended = episode.reset_ended or message.time
        n, action = whole_number(message, match[1]), vector(message, match[2])
        if n != len(episode.steps) + 1:
            self._problem(message, f"expected env step {len(episode.steps) + 1}, got {n}")
        episode.steps.append(TextStep(line=message.line, n=n, action=action, started=message.time))

    def _offset(self, message: LoggedMessage, text: str) -> None:
        step = self._open_step(message, "offset")
        if step:
            step.offset, step.ended = vector(message, text), message.time

    def _info(self, message: LoggedMessage, text: str) -> None:
        step = self._open_step(message, "info")
        if step:
            step.info = printed_dict(message, text)

    def _reward(self, message: LoggedMessage, text: str) -> None:
        step = self._open_step(message, "reward")
        if step:
            step.reward = number(message, text)

    def _result(self, message: LoggedMessage, text: str) -> None:
        episode = self._open_episode(message)
        if not episode:
            return
        self._end_step(episode, message)
        if text.strip() not in ("SUCCESS", "FAIL"):
            self._problem(message, f"expected RESULT SUCCESS or FAIL, got {text!r:.40}")
        episode.success, episode.ended = text.strip() == "SUCCESS", message.time

    def _success_rate(self, message: LoggedMessage, match: re.Match[str]) -> None:
        if self.log.has_totals:
            self._problem(message, "the totals are repeated")
        self.log.has_totals = True
        percent, fraction = match[1], match[2]
        self.log.claimed_success_rate = number(message, percent) / 100 if percent else number(message, fraction or "0")
        if self.log.claimed_success_rate > 1:
            self._problem(
                message, f"expected a success rate of at most 100 %, got {percent or fraction}{' %' * bool(percent)}"
            )

    def _average_steps(self, message: LoggedMessage, match: re.Match[str]) -> None:
        self.log.claimed_average_steps = number(message, match[1]) if match[1] else None

    def _open_episode(self, message: LoggedMessage) -> TextEpisode | None:
        if self.log.episodes and self.log.episodes[-1].success is None:
            return self.log.episodes[-1]
        self._problem(message, "it is outside a test")
        return None

    def _open_step(self, message: LoggedMessage, part: str) -> TextStep | None:
        """Return the env step that a part belongs to; None if there is none or it already has this part."""
        episode = self._open_episode(message)
        if not episode:
            return None
        if not episode.steps:
            self._problem(message, "it is before the first action")
            return None
        if part in self._parts_of_step:
            self._problem(message, f"a second {part} of this env step")
            return None
        self._parts_of_step.add(part)
        return episode.steps[-1]

    def _end_step(self, episode: TextEpisode, message: LoggedMessage) -> None:
        if episode.steps and episode.steps[-1].ended is None:
            episode.steps[-1].ended = message.time

    def _problem(self, message: LoggedMessage, what: str) -> None:
        self.log.problems.append(f"line {message.line}: {what}")
        self.log.misplaced.append(message.line)
        if len(self.log.problems) > MAX_PROBLEMS:
            raise TextLogRejected(
                f"Line {message.line}: more than {MAX_PROBLEMS} lines are misplaced.", line=message.line
            )
