"""What operators decide at the console, and when a trial has to wait for them. Every help is noted with its length.

The station's thread asks and waits; the page's threads answer. Of two operators who answer one question the first one
counts, and the other reads so. Nothing here knows whose policy plays.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from threading import Condition
from time import monotonic, sleep
from typing import Any, Final

from vitac.errors import VitacError
from vitac.evaluator.episodes.records import HelpKind, HumanHelp

from .guard import StationStopped

_NOTE_CHARACTERS: Final = 500
_PAUSE_S: Final = 2.0
"""After a stop, where nobody has to release the station."""
_SAFE: Final = ("Nothing touches the stage.", "Peg or key is in its garage or in the gripper.", "Nobody is in reach.")


class OperatorDecision(StrEnum):
    """What an operator may answer."""

    ACCEPT = "accept"
    REFUSE = "refuse"
    REGRASP = "regrasp"


class DecisionRefused(VitacError):
    """The console does not take this decision; the message says why."""


@dataclass(frozen=True, kw_only=True)
class OperatorQuestion:
    """What is decided next.

    Attributes:
        number: of the question; an answer to another one is refused.
        text: in sentences.
        measured: what the station has looked at itself.
        checklist: what people look at before they accept.
        decisions: that may be taken.
    """

    number: int
    text: str
    measured: tuple[str, ...]
    checklist: tuple[str, ...]
    decisions: tuple[OperatorDecision, ...]


@dataclass(kw_only=True)
class Operator:
    """The people at a console.

    Attributes:
        asks: whether trials wait for them; otherwise they may only step in.
        about: what is played, as the page shows it.
        phase: what the station does now.
        stop_reason: why they stopped it, until they release it.
    """

    asks: bool
    about: Mapping[str, Any] = field(default_factory=dict)
    phase: str = "No trial is running."
    stop_reason: str | None = None
    _number: int = 0
    _question: OperatorQuestion | None = None
    _decision: tuple[OperatorDecision, str] | None = None
    _last: str = ""
    _paused_at: float | None = None
    _cancelled: str | None = None
    _stopped_at: float = 0.0
    _is_releasing: bool = False
    _began: float = field(default_factory=monotonic)
    _help: list[tuple[HelpKind, float, float, str]] = field(default_factory=list)
    _changed: Condition = field(default_factory=Condition)

    def begin(self, about: Mapping[str, Any]) -> None:
        """Begin a trial: what people have done since the last one is noted with this one."""
        with self._changed:
            self.about, self._began = about, monotonic()

    def end(self) -> tuple[HumanHelp, ...]:
        """End the trial; return how people helped in it and since the one before."""
        with self._changed:
            self.phase, self.about = "The trial is over.", {}
            helps = [
                HumanHelp(kind=kind, at_s=round(at_s - self._began, 1), length_s=round(length_s, 1), note=note)
                for kind, at_s, length_s, note in self._help
            ]
            self._help.clear()
        return tuple(helps)

    @property
    def is_awaited(self) -> bool:
        """Whether the station waits for a person."""
        return self._question is not None or self._paused_at is not None

    def ask(
        self,
        text: str,
        decisions: Sequence[OperatorDecision],
        checklist: Sequence[str] = (),
        measured: Sequence[str] = (),
    ) -> tuple[OperatorDecision, str]:
        """Wait for a decision, and return it with its note.

        Raises:
            StationStopped: the trial was ended meanwhile.
        """
        with self._changed:
            self._number += 1
            self._decision = None
            self._question = OperatorQuestion(
                number=self._number,
                text=text,
                measured=tuple(measured),
                checklist=tuple(checklist),
                decisions=tuple(decisions),
            )
            try:
                self._wait_until(lambda: self._decision is not None)
            finally:
                self._question = None
            decision: tuple[OperatorDecision, str] = self._decision or (OperatorDecision.REFUSE, "")
            return decision

    def wait_while_paused(self, phase: str) -> None:
        """Say what the station does next, and wait as long as operators pause it.

        Raises:
            StationStopped: the trial was ended meanwhile.
        """
        with self._changed:
            self.phase = phase
            self._wait_until(lambda: self._paused_at is None)

    def make_safe(self, reason: str) -> None:
        """Wait until the station may move again after a stop: a moment where nobody is asked and nobody stopped it.

        Raises:
            StationStopped: the agent ends meanwhile.
        """
        if not self.asks and self.stop_reason is None:
            sleep(_PAUSE_S)
            return
        with self._changed:
            if self.stop_reason is None:
                self.stop_reason, self._stopped_at = reason, monotonic()
            self._is_releasing = True
        try:
            _, note = self.ask(f"{reason} Make the station safe, then release it.", (OperatorDecision.ACCEPT,), _SAFE)
        finally:
            self._is_releasing = False
        self.note_help(HelpKind.RELEASE, self._stopped_at, note)
        self.stop_reason = None

    def note_help(self, kind: HelpKind, began: float, note: str = "") -> None:
        """Note a help that ends now, from the time at which it began on the monotonic clock [s]."""
        self._help.append((kind, began, monotonic() - began, note))

    def stop(self, reason: str) -> None:
        """Note that an operator stopped the station: nothing moves before one has released it.

        Raises:
            DecisionRefused: it is stopped.
        """
        with self._changed:
            if self.stop_reason is not None:
                raise DecisionRefused("The station is stopped already.")
            self.stop_reason, self._stopped_at = reason, monotonic()
            self._changed.notify_all()

    def open(self) -> None:
        """Let the next shard wait for people again."""
        self._cancelled = None

    def cancel(self, reason: str) -> None:
        """End all waiting of the running shard, which is given back."""
        with self._changed:
            self._cancelled = reason
            self._changed.notify_all()

    def decide(self, number: int, decision: OperatorDecision, note: str = "") -> None:
        """Answer a question.

        Raises:
            DecisionRefused: it is answered already, asks something else, or a refusal has no note.
        """
        with self._changed:
            question = self._question
            if question is None or self._decision is not None or number != question.number:
                raise DecisionRefused(f"This was decided already{self._last}. Look at the page as it is now.")
            if decision not in question.decisions:
                raise DecisionRefused(f"Expected {' or '.join(question.decisions)}, got {decision}.")
            note = _check_note(note)
            if decision is OperatorDecision.REFUSE and not note:
                raise DecisionRefused("Say in the note why the trial is refused.")
            self._decision, self._last = (decision, note), f" ({decision})"
            self._changed.notify_all()

    def pause(self) -> None:
        """Let the station wait before its next motion.

        Raises:
            DecisionRefused: it is paused.
        """
        with self._changed:
            if self._paused_at is not None:
                raise DecisionRefused("The station is paused already.")
            self._paused_at = monotonic()

    def resume(self) -> None:
        """End the pause.

        Raises:
            DecisionRefused: it is not paused.
        """
        with self._changed:
            if self._paused_at is None:
                raise DecisionRefused("The station is not paused.")
            self.note_help(HelpKind.PAUSE, self._paused_at)
            self._paused_at = None
            self._changed.notify_all()

    def write_note(self, text: str) -> None:
        """Note a sentence in the trial's record.

        Raises:
            DecisionRefused: it is empty or too long.
        """
        if not _check_note(text):
            raise DecisionRefused("Expected a note, got nothing.")
        self.note_help(HelpKind.NOTE, monotonic(), text.strip())

    def describe(self) -> dict[str, Any]:
        """Return what the page shows."""
        with self._changed:
            question = self._question if self._decision is None else None
            paused_s = None if self._paused_at is None else monotonic() - self._paused_at
            return {
                "about": dict(self.about),
                "phase": self.phase if question is None else "The station waits for a decision.",
                "paused_s": paused_s,
                "stopped": self.stop_reason,
                "help": [f"{kind}, {length_s:.0f} s. {note}".strip() for kind, _, length_s, note in self._help],
                "question": question
                and {
                    "number": question.number,
                    "text": question.text,
                    "measured": question.measured,
                    "checklist": question.checklist,
                    "decisions": question.decisions,
                },
            }

    def _wait_until(self, is_so: Callable[[], bool]) -> None:
        """Wait; raise StationStopped if the trial has to end. A stopped station waits for its release all the same."""

        def end_reason() -> str | None:
            return self._cancelled or (None if self._is_releasing else self.stop_reason)

        self._changed.wait_for(lambda: is_so() or end_reason() is not None)
        if (reason := end_reason()) is not None:
            raise StationStopped(reason)


def _check_note(text: str) -> str:
    if len(text) > _NOTE_CHARACTERS:
        raise DecisionRefused(f"The note has {len(text)} characters: expected at most {_NOTE_CHARACTERS}.")
    return text.strip()
