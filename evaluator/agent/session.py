"""Loads a policy in a sandbox and gives each episode a copy of it. Called by `shards.policy`."""

import contextlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from multiprocessing.connection import wait
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from ..isolation_kinds import IsolationKind
from ..package_sets import PackageSet
from .exchange import LOADER_PID, Deadlines, EpisodeProcess, Exchange
from .isolation import process_tree, tracing
from .isolation.bubblewrap import UserIsolation
from .isolation.cgroup import MemoryIsolation
from .isolation.gpu import ImageProgram
from .isolation.memory_files import FileIsolation
from .isolation.process_tree import ProcessIds
from .isolation.sandbox import Sandbox
from .isolation.shared_core import SharedCore
from .isolation.tracing import TracedProcessGone
from .limits import Limits, ShardTime, StartTimes, default_period_s
from .loaded_copy import LoadedCopy
from .protocol import (
    AnswerKind,
    Array,
    CloudSpec,
    PolicyAnswer,
    PolicyQuestion,
    QuestionKind,
    add_clouds,
    checked_action,
    checked_belief,
)
from .verdicts import PolicyFailed, SandboxFailed, VerdictCode

ISOLATION_VARIABLE: Final = "VITAC_ISOLATION"
_REPORT_DEADLINE_S: Final = 2.0
_ATTEMPTS: Final = 3


class EpisodeIsolation(StrEnum):
    """What keeps one episode's memory from the next."""

    FROZEN_COPY = "frozen-copy"
    """Loaded once and frozen; each episode runs in a copy."""
    FRESH_PROCESS = "fresh-process"
    """Loaded again, in a new sandbox, for each episode."""


@dataclass(frozen=True, kw_only=True)
class Isolation:
    """How strongly a policy was isolated; recorded with the result."""

    user: UserIsolation
    memory: MemoryIsolation
    episodes: EpisodeIsolation
    files: FileIsolation
    process_ids_repeat: bool
    """True where an episode's process id does not show how many episodes there were before."""
    episode_period_s: float = 0.0
    """From the start of an episode to that of the next [s], see `StartTimes`; 0: each starts as soon as it can."""
    kind: IsolationKind = IsolationKind.NAMESPACES


def default_episode_isolation() -> EpisodeIsolation:
    """Return the kind that this machine can do, or the one named by VITAC_EPISODE_ISOLATION."""
    named = os.environ.get("VITAC_EPISODE_ISOLATION")
    if named:
        return EpisodeIsolation(named)
    return EpisodeIsolation.FRESH_PROCESS if tracing.explain_unsupported() else EpisodeIsolation.FROZEN_COPY


def default_kind() -> IsolationKind:
    """Return what VITAC_ISOLATION names, namespaces without it.

    Raises:
        SandboxFailed: it names neither.
    """
    named = os.environ.get(ISOLATION_VARIABLE) or IsolationKind.NAMESPACES
    if named not in tuple(IsolationKind):
        raise SandboxFailed(f"Expected {ISOLATION_VARIABLE} to be {' or '.join(IsolationKind)}, got {named!r:.80}.")
    return IsolationKind(named)


class PolicySession:
    """Loads a submission's policy once and plays episodes with it; belongs to the thread that opens it.

    Args:
        submission_dir: folder that holds submission.yaml and the policy's code.
        entry_point: `module:Class` below it.
        image: what is run in place of a class; each episode has processes of its own.
        limits: what the policy may use.
        packages: sets of packages that its track declares.
        episode_isolation: what keeps episodes apart; by default the strongest and fastest that this platform can do.
        episode_period_s: from the start of an episode to that of the next [s]; by default what the machine is set to.
        kind: what stands between the policy and the machine; by default what the machine is set to. Under `vm` each
            episode has a process and a kernel of its own.

    Raises:
        PolicyFailed: on entering, the policy does not import or load.
        SandboxFailed: on entering, this machine cannot isolate it.
    """

    def __init__(
        self,
        submission_dir: Path,
        *,
        entry_point: str = "policy:Policy",
        image: ImageProgram | None = None,
        limits: Limits | None = None,
        packages: tuple[PackageSet, ...] = (),
        episode_isolation: EpisodeIsolation | None = None,
        episode_period_s: float | None = None,
        kind: IsolationKind | None = None,
    ) -> None:
        self._submission_dir = submission_dir
        self._entry_point = entry_point
        self._image = image
        self._limits = limits or Limits()
        self._packages = packages
        self._kind = kind or default_kind()
        self._episodes = episode_isolation or default_episode_isolation()
        if image is not None or self._kind is not IsolationKind.NAMESPACES:
            self._episodes = EpisodeIsolation.FRESH_PROCESS
        self._start_times = StartTimes(default_period_s() if episode_period_s is None else episode_period_s)
        self._exits = contextlib.ExitStack()
        self._sandbox: Sandbox | None = None
        self._loaded: LoadedCopy | None = None
        self._loaded_process: EpisodeProcess | None = None
        self._core = SharedCore()
        self._ended: EpisodeProcess | None = None
        """What played the last episode, until it is certain that nothing of it is left."""
        self._isolation: Isolation | None = None
        self._shard_time = ShardTime(self._limits)
        self._loading_s = (0.0, 0.0)
        """CPU time and time by the clock of the last loading."""
        self.starts = 0
        """How often the policy was loaded."""

    def __enter__(self) -> Self:
        self._start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop()

    @property
    def isolation(self) -> Isolation:
        """How strongly the policy is isolated on this machine."""
        if self._isolation is None:
            raise SandboxFailed("The session was never started; use it as a context manager.")
        return self._isolation

    def begin_shard(self) -> None:
        """Let the limits on a shard's time hold for another shard from here on.

        It pays for the loading as one in a new process does, so that no verdict depends on which of both it is.
        """
        self._shard_time = ShardTime(self._limits)
        self._shard_time.cpu_s, self._shard_time.wall_s = self._loading_s

    @contextlib.contextmanager
    def episode(
        self, *, task: str, action_shape: tuple[int, ...], clouds: Sequence[CloudSpec] = ()
    ) -> Iterator["EpisodePolicy"]:
        """Give a fresh copy of the loaded policy for one episode, after its `reset(task)`.

        Args:
            task: name for `reset`.
            action_shape: that its actions must have.
            clouds: what the policy gets besides the arrays that are sent.

        Raises:
            PolicyFailed: reset failed, or the policy had to be loaded again and that failed.
            SandboxFailed: this machine failed.
        """
        sandbox, process = self._start_episode()
        try:
            policy = EpisodePolicy(
                sandbox,
                process,
                limits=self._limits,
                shard_time=self._shard_time,
                core=self._core,
                action_shape=action_shape,
                clouds=clouds,
                makes_clouds=self._image is not None,
            )
            policy.reset(task)
            yield policy
            policy.check_silent()
        finally:
            self._end_episode(process)

    def _start_episode(self) -> tuple[Sandbox, EpisodeProcess]:
        self._core.follow()
        self._clear_after_last()
        for _ in range(_ATTEMPTS):
            sandbox = self._sandbox or self._start()
            self._start_times.wait()
            sandbox.output.restart_count()  # before the copy, whose output is to look as if never read or written
            try:
                process = self._copy()
            except (TracedProcessGone, ProcessLookupError):
                self._stop()
                continue
            except OSError as error:
                message = f"The loaded policy could not be copied for an episode: {error.strerror}."
                raise PolicyFailed(VerdictCode.CRASHED, message, sandbox.output.text()) from error
            self._core.add(process.outside_pid)
            return sandbox, process
        raise PolicyFailed(VerdictCode.CRASHED, "The loaded policy ended by itself before an episode could start.")

    def _copy(self) -> EpisodeProcess:
        if self._loaded is not None:
            return self._loaded.copy()
        if self._loaded_process is None:
            raise ProcessLookupError
        return self._loaded_process

    def _end_episode(self, process: EpisodeProcess) -> None:
        """Kill all that the episode started; it ends while the next episode's scene is built."""
        self._core.remove(process.outside_pid)
        if self._loaded is None or not self._loaded.kill_all_others():
            self._stop()
        else:
            self._ended = process

    def _clear_after_last(self) -> None:
        """Remove everything that the last episode left: clear the sandbox, or end it where that fails."""
        process, self._ended = self._ended, None
        if process is None or self._sandbox is None or self._loaded is None:
            return
        sandbox = self._sandbox
        cleared = self._loaded.clear()
        if not cleared or not _end_was_reported(sandbox, process) or sandbox.channel.has_unread_question():
            self._stop()
            return
        sandbox.forget_statuses()
        sandbox.channel.reset()

    def _start(self) -> Sandbox:
        self._shard_time.check()
        self.starts += 1
        try:
            sandbox = self._exits.enter_context(
                Sandbox(
                    self._submission_dir,
                    limits=self._limits,
                    packages=self._packages,
                    kind=self._kind,
                    image=self._image,
                )
            )
            self._load(sandbox)
        except BaseException:
            self._stop()
            raise
        self._sandbox = sandbox
        self._isolation = Isolation(
            user=sandbox.user_isolation,
            memory=sandbox.memory_isolation,
            episodes=self._episodes,
            files=sandbox.file_isolation,
            process_ids_repeat=self._loaded is None or self._loaded.process_ids_repeat,
            episode_period_s=self._start_times.period_s,
            kind=self._kind,
        )
        return sandbox

    def _stop(self) -> None:
        self._sandbox = self._loaded = self._loaded_process = self._ended = None
        self._core = SharedCore()
        self._exits.close()

    def _load(self, sandbox: Sandbox) -> None:
        exchange = Exchange(sandbox, limits=self._limits, process=None)
        deadlines = Deadlines(
            what="importing and loading",
            wall_s=self._limits.start_wall_s,
            cpu_s=self._limits.start_cpu_s,
            wall_verdict=VerdictCode.START_TIMEOUT,
        )
        started = time.perf_counter()
        try:
            question = PolicyQuestion(kind=QuestionKind.LOAD, text=self._entry_point)
            answer = exchange.ask(question, AnswerKind.LOADED, deadlines)
        finally:
            self._loading_s = (sandbox.cpu_s(), time.perf_counter() - started)
            self._shard_time.cpu_s += self._loading_s[0]
            self._shard_time.wall_s += self._loading_s[1]
        try:
            self._loaded_process = EpisodeProcess(
                outside_pid=answer.sender_pid, inside_pid=self._find_inside_pid(answer)
            )
            if self._episodes is EpisodeIsolation.FROZEN_COPY:
                self._freeze(sandbox, exchange, answer.sender_pid)
        except (TracedProcessGone, ProcessLookupError):
            raise exchange.failure(VerdictCode.CRASHED, "The policy ended right after it was loaded.") from None

    def _find_inside_pid(self, answer: PolicyAnswer) -> int:
        """Return the pid inside of the process that answers; without namespaces nothing but itself knows it.

        A false one is of no use to it: it explains how its process ended. An image plays for as long as its command.
        """
        if self._image is not None:
            return LOADER_PID
        if self._kind is IsolationKind.NAMESPACES:
            return process_tree.inside_pid(answer.sender_pid)
        reported = answer.header.message
        return int(reported) if reported.isascii() and reported.isdigit() else 0

    def _freeze(self, sandbox: Sandbox, exchange: Exchange, loaded_pid: int) -> None:
        sandbox.spare(loaded_pid)
        try:
            process_ids = self._exits.enter_context(ProcessIds(sandbox.first_pid))
            self._loaded = LoadedCopy(
                loaded_pid,
                process_ids=process_ids,
                own_files=sandbox.own_files,
                episode_cpu_s=self._limits.episode_cpu_s,
            )
        except PolicyFailed as failure:
            raise exchange.failure(failure.verdict, failure.message) from None
        except OSError as error:  # names longer than a path may be, links that cannot be read
            left = f"What the policy left in its files while loading cannot be looked through: {error.strerror}."
            raise exchange.failure(VerdictCode.SHARED_STATE, left) from None
        self._exits.callback(self._loaded.end)
        for pid in (loaded_pid, sandbox.first_pid, *process_ids.pids):
            self._core.add(pid)
        sandbox.channel.reset()
        sandbox.forget_statuses()


class EpisodePolicy:
    """One episode's copy of the policy."""

    def __init__(
        self,
        sandbox: Sandbox,
        process: EpisodeProcess,
        *,
        limits: Limits,
        shard_time: ShardTime,
        core: SharedCore,
        action_shape: tuple[int, ...],
        clouds: Sequence[CloudSpec],
        makes_clouds: bool,
    ) -> None:
        self._sandbox = sandbox
        self._clouds = clouds
        self._makes_clouds = makes_clouds
        """Whether clouds are made here; else the runtime in the sandbox makes them, of which an image has none."""
        self._limits = limits
        self._shard_time = shard_time
        self._core = core
        self._action_shape = action_shape
        self._exchange = Exchange(sandbox, limits=limits, process=process)
        self._cpu_start_s = sandbox.cpu_s()
        self.cpu_s = 0.0
        """CPU time of the policy so far, all its processes together, while it is asked and meanwhile [s]."""
        self.answers_s: tuple[float, ...] = ()
        self.channel_s = 0.0
        """Wall time of the exchanges that the policy did not compute in [s]."""

    def reset(self, task: str) -> None:
        """Tell the policy which task begins; the session has done so already.

        Raises:
            PolicyFailed: any verdict.
        """
        self._ask(PolicyQuestion(kind=QuestionKind.RESET, text=task), AnswerKind.READY, "reset()")

    def act(self, observation: Mapping[str, Array]) -> NDArray[np.float32]:
        """Return the policy's action: float32, of the task's shape, finite, not clipped.

        Raises:
            PolicyFailed: any verdict.
        """
        if self._makes_clouds:
            question = PolicyQuestion(kind=QuestionKind.OBSERVE, arrays=add_clouds(self._clouds, observation))
        else:
            question = PolicyQuestion(kind=QuestionKind.OBSERVE, arrays=observation, clouds=self._clouds)
        answer = self._ask(question, AnswerKind.ACTION, "act()")
        with self._explained():
            return checked_action(answer.arrays, self._action_shape)

    def belief(self, size: int) -> NDArray[np.float32] | None:
        """Return what the policy believes of what it saw last, shape [size]; None where it does not say.

        No score depends on it: nothing but `vitac show` asks. Its time counts neither for the episode nor for the
        shard, which so end as they do where nobody asks; the kernel's own limit on the process counts all.

        Raises:
            PolicyFailed: any verdict; where `belief()` raised or returned something else, the episode continues.
        """
        self._count_cpu()
        limits = self._limits
        deadlines = Deadlines(what="belief()", wall_s=limits.action_wall_s, cpu_s=limits.action_cpu_s)
        try:
            answer = self._exchange.ask(PolicyQuestion(kind=QuestionKind.BELIEVE), AnswerKind.BELIEF, deadlines)
        finally:
            self._cpu_start_s = self._sandbox.cpu_s() - self.cpu_s
        with self._explained():
            return checked_belief(answer.arrays, (size,))

    @property
    def output(self) -> str:
        """The end of what the policy has printed in the episode, safe to print."""
        self._sandbox.output.read_available()
        return self._sandbox.output.text()

    def check_silent(self) -> None:
        """Make sure that the policy has sent nothing after its last answer.

        Raises:
            PolicyFailed: protocol_violation.
        """
        with self._explained():
            self._sandbox.channel.check_silent()

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        """Give a verdict the reason behind it and what the policy has printed."""
        try:
            yield
        except PolicyFailed as failure:
            raise self._exchange.failure(failure.verdict, failure.message) from None

    def _ask(self, question: PolicyQuestion, expected: AnswerKind, what: str) -> PolicyAnswer:
        self._count_cpu()
        self._check_time_left()
        left_s = self._limits.episode_cpu_s - self.cpu_s
        deadlines = Deadlines(
            what=what, wall_s=self._limits.action_wall_s, cpu_s=min(self._limits.action_cpu_s, left_s)
        )
        started, cpu_before_s = time.perf_counter(), self.cpu_s
        self._core.follow()
        try:
            return self._exchange.ask(question, expected, deadlines)
        finally:
            self._count_cpu()
            wall_s = time.perf_counter() - started
            self._shard_time.wall_s += wall_s
            self.channel_s += max(0.0, wall_s - (self.cpu_s - cpu_before_s))

    def _check_time_left(self) -> None:
        if self.cpu_s >= self._limits.episode_cpu_s:
            message = f"The episode used more than {self._limits.episode_cpu_s:g} s of CPU time."
            raise self._exchange.failure(VerdictCode.CPU_TIME, message)
        with self._explained():
            self._shard_time.check()

    def _count_cpu(self) -> None:
        """Take the time used so far; without a control group, that of processes nobody waited for is not in it."""
        now_s = max(self.cpu_s, self._sandbox.cpu_s() - self._cpu_start_s)
        self._shard_time.cpu_s += now_s - self.cpu_s
        self.cpu_s = now_s


def _end_was_reported(sandbox: Sandbox, process: EpisodeProcess) -> bool:
    """Wait until the first process has reported the end of the episode's process, so that its pid may be used again."""
    deadline = time.monotonic() + _REPORT_DEADLINE_S
    while sandbox.exit_status(process.inside_pid) is None:
        if time.monotonic() > deadline or sandbox.has_ended():
            return False
        wait([sandbox.status_descriptor], 0.05)
    return True
