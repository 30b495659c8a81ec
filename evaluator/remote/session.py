"""Plays episodes at a policy server, or asks it one blank observation of each task."""

import contextlib
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from ..agent.limits import Limits, ShardTime
from ..agent.protocol import CloudSpec, add_clouds, checked_action
from ..agent.verdicts import EpisodeCut, PolicyFailed, VerdictCode
from ..tracks import Task
from .codec import read_array
from .description import RemoteServer
from .line import Dialogue, LineLost, LineSilent
from .protocols import check_address, open_dialogue

_CUTS_MAX: Final = 3
"""Cuts of the line in a row after which an episode is not played again."""
_WORD_S: Final = 2.0
"""Time for a word that has no answer."""


class RemoteSession:
    """Asks a policy server; belongs to the thread that enters it.

    Entering it opens the line, and an episode after a cut opens it again. A cut ends its episode, which is played again
    from its start; the third in a row fails it. Until the first answer on a line the limits of the start hold.

    Args:
        address: `ws://`, `wss://` or `grpc://`; of this machine where the policy dials us.
        server: what submission.yaml says of it.
        limits: those by the clock hold for it.

    Raises:
        PolicyFailed: on entering, nobody answered at the address, or not as the protocol says.
    """

    isolation = None

    def __init__(self, address: str, server: RemoteServer, limits: Limits | None = None) -> None:
        check_address(address, server.protocol)
        self._address = address
        self._server = server
        self._limits = limits or Limits()
        self._time = ShardTime(self._limits)
        self._dialogue: Dialogue | None = None
        self._cuts = 0
        self._has_answered = False

    def __enter__(self) -> Self:
        self._open()
        return self

    def __exit__(self, *exception: object) -> None:
        self._hang_up()

    def begin_shard(self) -> None:
        """Count the time of another shard from here on."""
        self._time = ShardTime(self._limits)

    @contextlib.contextmanager
    def episode(
        self, *, task: str, action_shape: tuple[int, ...], clouds: Sequence[CloudSpec] = ()
    ) -> Iterator["RemotePolicy"]:
        """Give the policy for one episode.

        Raises:
            PolicyFailed: it cannot be reached, or broke a rule.
            EpisodeCut: the line was cut; the episode is to be played again.
        """
        with self._waited("The beginning of an episode", _WORD_S):
            dialogue = self._dialogue or self._open()
            prompt = self._server.prompt or task
            dialogue.begin(prompt, time.monotonic() + _WORD_S)
        policy = RemotePolicy(self, dialogue, prompt, action_shape, clouds)
        yield policy
        # What was played stands, whatever becomes of the line.
        with contextlib.suppress(PolicyFailed, EpisodeCut), self._waited("The end of an episode", _WORD_S):
            dialogue.end(time.monotonic() + _WORD_S)
        self._cuts = 0

    def ask(self, dialogue: Dialogue, observation: Mapping[str, NDArray[Any]], prompt: str) -> NDArray[np.generic]:
        """Return the actions that answer an observation, shape [action] or [actions, action]."""
        limit_s = self._limits.action_wall_s if self._has_answered else self._limits.start_wall_s
        with self._waited("The answer to an observation", limit_s):
            sent = self._server.names(observation)
            actions = read_array(dialogue.ask(sent, prompt, time.monotonic() + limit_s))
        self._has_answered = True
        return actions

    def rows(self, actions: NDArray[np.generic], action_shape: tuple[int, ...]) -> Iterator[NDArray[np.float32]]:
        """Return the actions of an answer that are to be played, float32, of the task's shape and finite.

        Raises:
            PolicyFailed: bad_action_type, bad_action_shape, non_finite_action.
        """
        execute = self._server.execute
        rows = actions[None] if actions.ndim == len(action_shape) else actions
        if rows.ndim != 1 + len(action_shape) or len(rows) < execute:
            raise PolicyFailed(
                VerdictCode.BAD_ACTION_SHAPE,
                f"An answer has actions of shape {actions.shape}, expected {execute} or more of shape {action_shape}.",
            )
        return (checked_action({"action": row}, action_shape) for row in rows[:execute])

    def _open(self) -> Dialogue:
        deadline_s = time.monotonic() + self._limits.start_wall_s
        try:
            self._dialogue = open_dialogue(self._address, self._server, deadline_s)
            self._dialogue.greet(deadline_s)
        except BaseException as error:
            self._hang_up()
            if isinstance(error, LineLost):
                raise PolicyFailed(VerdictCode.LINE_LOST, str(error)) from error
            if isinstance(error, LineSilent):
                message = f"The policy server did not greet within {self._limits.start_wall_s:g} s."
                raise PolicyFailed(VerdictCode.START_TIMEOUT, message) from error
            raise
        return self._dialogue

    @contextlib.contextmanager
    def _waited(self, what: str, limit_s: float) -> Iterator[None]:
        """Count the time of an exchange, and name what ended it; the line is closed, as what is on it is unknown."""
        self._time.check()
        started_s = time.monotonic()
        try:
            yield
        except BaseException as error:
            self._hang_up()
            if isinstance(error, LineSilent):
                message = f"{what} took longer than {limit_s:g} s."
                raise PolicyFailed(VerdictCode.WALL_TIME, message) from error
            if isinstance(error, LineLost):
                self._cuts += 1
                if self._cuts < _CUTS_MAX:
                    raise EpisodeCut(str(error)) from error
                raise PolicyFailed(VerdictCode.LINE_LOST, f"{error} So did {_CUTS_MAX - 1} lines before.") from error
            raise
        finally:
            self._time.wall_s += time.monotonic() - started_s

    def _hang_up(self) -> None:
        if self._dialogue is not None:
            self._dialogue.close()
        self._dialogue = None
        self._has_answered = False


class RemotePolicy:
    """The policy within one episode."""

    cpu_s = 0.0
    """Not known of another machine."""
    output = ""

    def __init__(
        self,
        session: RemoteSession,
        dialogue: Dialogue,
        prompt: str,
        action_shape: tuple[int, ...],
        clouds: Sequence[CloudSpec],
    ) -> None:
        self._session = session
        self._dialogue = dialogue
        self._prompt = prompt
        self._action_shape = action_shape
        self._clouds = clouds
        self._actions: deque[NDArray[np.float32]] = deque()
        self.answers_s: list[float] = []
        """From each question to its answer [s]."""

    @property
    def channel_s(self) -> float:
        """Time between questions and answers [s]."""
        return sum(self.answers_s)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Return the next action of the last answer, or the first of a new one.

        Raises:
            PolicyFailed: any verdict that is found from outside.
            EpisodeCut: the line was cut; the episode is to be played again.
        """
        if not self._actions:
            started_s = time.monotonic()
            try:
                answer = self._session.ask(self._dialogue, add_clouds(self._clouds, observation), self._prompt)
            finally:
                self.answers_s.append(time.monotonic() - started_s)
            self._actions.extend(self._session.rows(answer, self._action_shape))
        return self._actions.popleft()


@dataclass(frozen=True, kw_only=True)
class BlankAnswer:
    """How a policy server answered a blank observation of a task.

    Attributes:
        task: its name.
        answer_s: from the question to the answer [s].
        low: smallest number of the action; what is beyond [-1, 1] is clipped.
        high: largest one.
    """

    task: str
    answer_s: float
    low: float
    high: float


def test_connection(
    address: str, server: RemoteServer, tasks: Iterable[Task], limits: Limits
) -> tuple[BlankAnswer, ...]:
    """Make sure that a policy server answers with an action of each task, and return its answers.

    Args:
        address: `ws://` or `wss://`.
        server: what submission.yaml says of it.
        tasks: that it is to play.
        limits: those by the clock hold.

    Raises:
        AddressInvalid: the address is none.
        PolicyFailed: it cannot be reached, or would fail an episode.
        EpisodeCut: it cut the line.
    """
    answers = []
    with RemoteSession(address, server, limits) as session:
        for task in tasks:
            keys = server.keys or [row.name for row in task.observables]
            blank = {row.name: np.zeros(row.shape, row.dtype) for row in task.observables if row.name in keys}
            with session.episode(task=task.name, action_shape=(len(task.actions),)) as policy:
                action = policy.act(blank)
            low, high = float(action.min()), float(action.max())
            answers.append(BlankAnswer(task=task.name, answer_s=policy.answers_s[0], low=low, high=high))
    return tuple(answers)
