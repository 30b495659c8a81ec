"""Checks a 2025 text log and re-simulates its actions, beside what it claims; called by `vitac log verify`."""

from collections.abc import Callable
from pathlib import Path
from typing import Final, Self

from ..episodes.episode import make_environment
from ..episodes.records import EpisodeOutcome
from ..episodes.replay import resimulate
from ..strict_model import StrictModel
from ..tracks import Task, load_track
from .packing import open_log
from .resimulation import read_recordings
from .text_2025 import TextLogRejected, TextLogSummary, is_text_log, read_text_log, summarize
from .text_2025.recordings import track_and_task_names

CANNOT_BE_VERIFIED: Final = (
    "A 2025 text log holds no states, and the 2025 simulator does not reproduce itself, so it cannot be verified: its "
    "numbers are checked against each other and the published rules, and its actions are re-simulated."
)


class ResimulatedTest(StrictModel):
    """How one test ended in the log and here; an env step is None where the recorded actions end before the test."""

    number: int
    claimed_success: bool
    success: bool
    logged_env_steps: int
    end_step: int | None


class TextLogCheck(StrictModel):
    """What a text log says, what is wrong with it, and where its actions lead in our physics."""

    track: str
    task: str
    summary: TextLogSummary
    missing_tests: int
    tests: tuple[ResimulatedTest, ...]

    @property
    def is_consistent(self) -> bool:
        """Whether it is whole and no number in it contradicts another."""
        return not self.missing_tests and not self.summary.problems

    @property
    def successes(self) -> int:
        """Tests that succeed here."""
        return sum(test.success for test in self.tests)

    @property
    def same_ends(self) -> int:
        """Tests that end here at the logged env step, and with the logged result."""
        return sum(
            test.end_step == test.logged_env_steps and test.success == test.claimed_success for test in self.tests
        )

    @classmethod
    def from_file(cls, path: Path, on_test: Callable[[int], object]) -> Self:
        """Check and re-simulate a text log.

        Args:
            path: the file, gzipped or not.
            on_test: gets the number of each re-simulated test.

        Raises:
            TextLogRejected: it cannot be read, or no task here is its own.
        """
        with open_log(path) as stream:
            script, summary = summarize(read_text_log(stream))
        track, name = track_and_task_names(script)
        task = load_track(track).tasks.get(name)
        if task is None:
            raise TextLogRejected(f"The log is of {script.name}, but there is no track with its task here.")
        tests = tuple(_tests(path, task, on_test))
        missing = len(task.episodes) - len(tests)
        return cls(track=track, task=name, summary=summary, missing_tests=missing, tests=tests)


def is_text_log_file(path: Path) -> bool:
    """Return whether a file starts like a 2025 text log, gzipped or not."""
    with open_log(path) as stream:
        return is_text_log(stream.peek())


def _tests(path: Path, task: Task, on_test: Callable[[int], object]) -> list[ResimulatedTest]:
    env, tests = make_environment(task.apply_text_log_settings(), None, ()), []
    for recording in read_recordings(path, task):
        played = resimulate(env, recording.episode, recording.actions)
        tests.append(
            ResimulatedTest(
                number=recording.episode.number,
                claimed_success=recording.success is True,
                success=played.outcome is EpisodeOutcome.SUCCESS,
                logged_env_steps=len(recording.actions),
                end_step=played.end_step,
            )
        )
        on_test(recording.episode.number)
    return tests
