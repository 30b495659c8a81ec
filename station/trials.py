"""Plays trials one after the other and repeats those that did not count, by one stated rule (`outcome`)."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from time import sleep
from typing import Final, Self

from vitac.evaluator.episodes.episode import OpenSession
from vitac.evaluator.episodes.reading import Reading
from vitac.evaluator.tracks import Episode, Task

from .description import StationDescription, StationTask
from .devices.device import DeviceFault, DeviceNotFound
from .eyes import Sight
from .fusion_trial import FusionTrial
from .opened import OpenStation, open_station
from .outcome import ATTEMPTS, TrialOutcome
from .trial import Attempt, Trial

_PAUSE_S: Final = 2.0
"""After a stop, where nobody has to release the station."""

Show = Callable[[int, int, str, Sight], None]


def wait_a_moment(_: str) -> None:
    """Release a station by itself after a moment, as twins are."""
    sleep(_PAUSE_S)


@dataclass(kw_only=True)
class Player:
    """Plays trials on a station; use it in `with`, which opens the devices when a trial needs them.

    Attributes:
        description: of the station.
        folder: where records are written.
        make_safe: called with the reason after a stop; returns when the station may move again.
        attempts: at a trial.
        show: called with episode, attempt, a word and what is seen.
    """

    description: StationDescription
    folder: Path
    make_safe: Callable[[str], None] = wait_a_moment
    attempts: int = ATTEMPTS
    show: Show = lambda _episode, _attempt, _word, _sight: None
    _opened: ExitStack = field(default_factory=ExitStack)
    _station: OpenStation | None = None
    _stopped_for: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def play(self, task: Task, episode: Episode, reading: Reading, open_session: OpenSession) -> list[Attempt]:
        """Play a trial until an attempt counts, at most `attempts` times, and return all of them."""
        played: list[Attempt] = []
        while len(played) < self.attempts and not (played and played[-1].outcome.counts):
            if self._stopped_for is not None:
                self.make_safe(self._stopped_for)
                self._stopped_for = None
            played.append(self._attempt(task, episode, reading, open_session, len(played) + 1))
        return played

    def stop(self, reason: str) -> None:
        """Stop what moves; the running attempt ends and does not count. Called from any thread."""
        station = self._station
        if station is not None:
            station.guard.stop(reason)

    def _attempt(
        self, task: Task, episode: Episode, reading: Reading, open_session: OpenSession, number: int
    ) -> Attempt:
        try:
            station = self._station = self._station or self._opened.enter_context(open_station(self.description))
        except (DeviceFault, DeviceNotFound) as error:
            self._close()
            self._stopped_for = str(error)
            return Attempt(outcome=TrialOutcome.DEVICE_FAULT, reason=str(error))
        is_fusion = StationTask(task.station_of or task.name) is StationTask.FUSION
        attempt = (FusionTrial if is_fusion else Trial)(
            station,
            task=task,
            episode=episode,
            reading=reading,
            open_session=open_session,
            folder=self.folder,
            show=lambda word, sight: self.show(episode.number, number, word, sight),
        ).play()
        if station.guard.reason is not None or attempt.outcome in _OPENED_AGAIN:
            self._stopped_for = attempt.reason
            self._close()
        return attempt

    def _close(self) -> None:
        self._station = None
        self._opened.close()
        self._opened = ExitStack()


_OPENED_AGAIN: Final = frozenset(
    {TrialOutcome.DEVICE_FAULT, TrialOutcome.STOPPED, TrialOutcome.REFUSED, TrialOutcome.NO_PEG}
)
