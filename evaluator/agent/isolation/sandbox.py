"""Starts and watches the process of a policy: in its sandbox, or as a process like any other where nothing isolates."""

import contextlib
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import wait
from pathlib import Path
from typing import Final, Self

from ...isolation_kinds import IsolationKind
from ...package_sets import PackageSet
from ..limits import Limits
from ..protocol import Channel
from ..verdicts import SandboxFailed
from . import bubblewrap, cgroup, gvisor, packages, process_tree, seccomp
from .bubblewrap import UserIsolation
from .cgroup import MemoryIsolation
from .gpu import ImageProgram
from .memory_files import (
    FileIsolation,
    default_file_isolation,
    is_in_memory,
    mount_point,
    prepare_system_files,
    with_submission_in_memory,
)
from .output import OutputTail
from .packages import package_folders

_INTERVAL_S: Final = 0.1


class MemoryWatchdog:
    """Kills the processes of a sandbox that together hold more resident memory than allowed."""

    def __init__(self, first_pid: int, *, memory_bytes: int) -> None:
        self._first_pid = first_pid
        self._memory_bytes = memory_bytes
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="memory-watchdog", daemon=True)
        self.spared_pid = 0
        """The loaded copy, which holds nothing that the episode's process does not hold as well."""
        self.kills = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()

    def look(self) -> None:
        """Look once."""
        pids = [pid for pid in process_tree.descendants(self._first_pid) if pid != self.spared_pid]
        # The first sum counts shared pages for everyone who shares them, but is quick; the second is exact.
        for size_of in (process_tree.resident_bytes, process_tree.proportional_bytes):
            if sum(map(size_of, pids)) <= self._memory_bytes:
                return
        self.kills += 1
        process_tree.kill_descendants(self._first_pid, spared_pid=self.spared_pid)

    def _watch(self) -> None:
        while not self._stop.wait(_INTERVAL_S):
            self.look()


_STATUS: Final = struct.Struct("<ii")
_START_DEADLINE_S: Final = 20.0
_STOP_DEADLINE_S: Final = 20.0
_JOIN_GROUPS: Final = 'while [ "$1" != -- ]; do echo 0 > "$1/cgroup.procs" || exit 97; shift; done; shift; exec "$@"'
"""A shell joins the control groups, so that no process of the sandbox was ever outside of them."""


@dataclass(frozen=True, kw_only=True)
class Resources:
    """Counters of one moment; differences between two moments explain a failure."""

    out_of_memory_kills: int
    refused_forks: int


class Sandbox:
    """Starts the runtime, isolated; as a context manager it leaves no process and no control group behind.

    Args:
        submission: folder that the policy is imported from.
        limits: what it may use.
        packages: sets of packages that its track declares.
        kind: what stands between it and the machine; under `vm` the files that it sees lie in memory, under `none` on
            the disk, else where the machine is set to.
        image: what is run in place of a policy's class.
    """

    def __init__(
        self,
        submission: Path,
        *,
        limits: Limits,
        packages: tuple[PackageSet, ...] = (),
        kind: IsolationKind = IsolationKind.NAMESPACES,
        image: ImageProgram | None = None,
    ) -> None:
        self._submission = submission if image is None else image.root
        self._image = image
        self._has_gpu = image is not None and image.gpu is not None
        self._lies_in_memory = image is not None and is_in_memory(image.root)
        self._packages = packages
        self._kind = kind
        fixed = {IsolationKind.VM: FileIsolation.MEMORY, IsolationKind.NONE: FileIsolation.DISK}
        self.file_isolation = fixed.get(kind) or default_file_isolation()
        self.limits = limits
        self._exits = contextlib.ExitStack()
        self._statuses: dict[int, int] = {}

    def __enter__(self) -> Self:
        try:
            self._start()
        except BaseException:
            self._exits.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self._exits.close()

    @property
    def user_isolation(self) -> UserIsolation:
        """The user whose rights the policy has."""
        return UserIsolation.NONE if self._kind is IsolationKind.NONE else bubblewrap.current_user_isolation()

    @property
    def memory_isolation(self) -> MemoryIsolation:
        """What keeps its processes together below the memory limit."""
        return self._group.isolation if self._group is not None else MemoryIsolation.WATCHDOG

    def resources(self) -> Resources:
        """Return the counters of this moment."""
        if self._group is None:
            return Resources(out_of_memory_kills=self._watchdog_kills(), refused_forks=self._processes_at_limit())
        return Resources(
            out_of_memory_kills=self._group.out_of_memory_kills() + self._watchdog_kills(),
            refused_forks=self._group.refused_forks(),
        )

    def cpu_s(self) -> float:
        """Return the CPU time of all its processes [s]; without a control group of those alive or waited for."""
        if self._group is not None:
            return self._group.cpu_s()
        pids = (self.first_pid, *process_tree.descendants(self.first_pid))
        return sum(process_tree.cpu_s(pid) + process_tree.reaped_cpu_s(pid) for pid in pids)

    def spare(self, pid: int) -> None:
        """Do not count the loaded copy's memory, which every copy of it counts again."""
        if self._watchdog is not None:
            self._watchdog.spared_pid = pid

    def exit_status(self, inside_pid: int) -> int | None:
        """Return how a process ended (as `os.wait` gives it), None while it runs."""
        self.read_statuses()
        return self._statuses.get(inside_pid)

    def forget_statuses(self) -> None:
        """Forget how processes ended, before a pid is used again."""
        self.read_statuses()
        self._statuses.clear()

    def read_statuses(self) -> None:
        """Take the reports of the first process that have come."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.status_descriptor, _STATUS.size * 256):
                self._statuses.update(_STATUS.iter_unpack(data[: len(data) - len(data) % _STATUS.size]))

    def has_ended(self) -> bool:
        """Return whether the whole sandbox has ended by itself."""
        return self._process.poll() is not None

    # Starting and stopping

    def _check_readable(self) -> None:
        """Refuse a submission that the policy's user cannot read: under root the policy runs as another user."""
        mode = self._submission.stat().st_mode
        if self.user_isolation is UserIsolation.ROOT and mode & 0o005 != 0o005:
            raise SandboxFailed(
                f"The folder {self._submission} may be entered by its owner only, but the policy runs as another user; "
                "copy the submission with `vitac.evaluator.submission.sources.stage` first."
            )

    def _start(self) -> None:
        self._check_readable()
        if self._image is not None and self._kind is IsolationKind.NONE:
            raise SandboxFailed("A container image plays in a sandbox only; `vitac doctor` says what is missing here.")
        if self._has_gpu and self._kind is IsolationKind.VM:
            raise SandboxFailed("The image says `needs: gpu`, which isolation vm has none of; play it in a namespace.")
        extra = gvisor.EXTRA_PROCESSES if self._kind is IsolationKind.VM else 0
        self._group = None
        if self._kind is not IsolationKind.NONE:
            self._group = cgroup.create(replace(self.limits, processes=self.limits.processes + extra))
        if self._group is None and self._kind is IsolationKind.VM:
            raise SandboxFailed(
                f"Isolation {self._kind} needs a control group, which limits processes inside; run as root, or as a "
                "service with `Delegate=yes`."
            )
        if self._group is not None:
            self._exits.callback(self._group.remove)
        ours, theirs = socket.socketpair()
        self._exits.callback(ours.close)
        output_read, output_write = os.pipe()
        self.output = OutputTail(output_read, kept_bytes=self.limits.output_kept_bytes)
        self._exits.callback(self.output.close)
        self.status_descriptor, status_write = self._pipe()
        self.own_files = frozenset({_proc_name(output_write, "pipe"), _proc_name(theirs.fileno(), "socket")})
        with contextlib.ExitStack() as given_away, theirs:
            given_away.callback(os.close, output_write)
            given_away.callback(os.close, status_write)
            start = {
                IsolationKind.NAMESPACES: self._start_bubblewrap,
                IsolationKind.VM: self._start_vm,
                IsolationKind.NONE: self._start_unisolated,
            }[self._kind]
            read_first_pid = start(given_away, theirs.fileno(), status_write, output_write)
        self._exits.callback(self._stop, ours)
        self.channel = Channel(ours, message_bytes=self.limits.message_bytes)
        self.first_pid = read_first_pid()
        self._wait_for_runtime()
        self._watchdog = self._start_watchdog()

    def _start_bubblewrap(
        self, given_away: contextlib.ExitStack, channel: int, status: int, output: int
    ) -> Callable[[], int]:
        """Start the process, and return how the pid of its first process inside is found out."""
        info_read, info_write = self._pipe()
        given_away.callback(os.close, info_write)
        uid = bubblewrap.choose_uid()
        descriptors = bubblewrap.Descriptors(
            seccomp=given_away.enter_context(
                bubblewrap.open_data(
                    seccomp.filter_program(() if self._image is None else ("chroot",), has_gpu=self._has_gpu)
                )
            ),
            passwd=given_away.enter_context(bubblewrap.open_data(bubblewrap.passwd_file(uid))),
            info=info_write,
        )
        passed = (channel, status, descriptors.seccomp, descriptors.passwd, info_write)
        self._process = _spawn(self._command(uid, descriptors), subprocess.DEVNULL, output, output, passed)
        return partial(self._read_first_pid, info_read)

    def _start_vm(self, _: contextlib.ExitStack, channel: int, status: int, output: int) -> Callable[[], int]:
        """Start the process, which is outside of all that the policy sees."""
        interpreter = packages.find_interpreter(self._packages)
        system = prepare_system_files(interpreter, own=bubblewrap.OWN_FILES)
        self._bundle = Path(self._exits.enter_context(tempfile.TemporaryDirectory(prefix="vitac-vm-")))
        command = gvisor.command(
            self._bundle,
            submission=self._find_submission(system),
            interpreter=interpreter,
            limits=self.limits,
            uid=bubblewrap.choose_uid(),
            system=system,
            image=self._image,
        )
        self._process = _spawn(self._with_submission(self._in_group(command), system), channel, output, status, ())
        return lambda: self._process.pid

    def _start_unisolated(self, _: contextlib.ExitStack, channel: int, status: int, output: int) -> Callable[[], int]:
        folder = Path(self._exits.enter_context(tempfile.TemporaryDirectory(prefix="vitac-policy-")))
        command = unisolated_command(folder, submission=self._submission, limits=self.limits)
        self._process = subprocess.Popen(  # noqa: S603 - the command holds paths of ours only
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, pass_fds=(channel, status),
            env=unisolated_environment(), start_new_session=True,
        )  # fmt: skip
        return lambda: self._process.pid

    def _pipe(self) -> tuple[int, int]:
        read, write = os.pipe()
        os.set_blocking(read, False)
        self._exits.callback(os.close, read)
        return read, write

    def _command(self, uid: int, descriptors: bubblewrap.Descriptors) -> list[str]:
        interpreter, system = packages.find_interpreter(self._packages), None
        if self.file_isolation is FileIsolation.MEMORY:
            system = prepare_system_files(interpreter, own=bubblewrap.OWN_FILES)
        command = bubblewrap.command(
            program=bubblewrap.find_program(),
            submission=self._find_submission(system),
            interpreter=interpreter,
            limits=self.limits,
            uid=uid,
            descriptors=descriptors,
            system=system,
            image=self._image,
        )
        command = self._in_group(command)
        return command if system is None else self._with_submission(command, system)

    def _in_group(self, command: list[str]) -> list[str]:
        if self._group is None:
            return command
        return ["/bin/sh", "-c", _JOIN_GROUPS, "sh", *map(str, self._group.folders), "--", *command]

    def _find_submission(self, system: Path | None) -> Path:
        """Return where the submission is bound from: an image is copied into memory by whoever unpacks it there."""
        return self._submission if system is None or self._lies_in_memory else mount_point(system)

    def _with_submission(self, command: list[str], system: Path) -> list[str]:
        if self._lies_in_memory:
            return command
        # Before the process joins the control groups: the submission does not count as the policy's memory.
        size_bytes = self.limits.archive_unpacked_bytes if self._image is None else self.limits.image_bytes
        return with_submission_in_memory(command, submission=self._submission, root=system, size_bytes=size_bytes)

    def _read_first_pid(self, descriptor: int) -> int:
        deadline = time.monotonic() + _START_DEADLINE_S
        data = b""
        while b"}" not in data:
            wait([descriptor], max(0.0, deadline - time.monotonic()))
            try:
                piece = os.read(descriptor, 4096)
            except BlockingIOError:
                piece = b""
            data += piece
            if not piece:
                raise self._start_failure()
        return int(json.loads(data.partition(b"}")[0] + b"}")["child-pid"])

    def _wait_for_runtime(self) -> None:
        """Wait for the first process's report about itself (pid 0); before it, no line of the policy has run."""
        deadline = time.monotonic() + _START_DEADLINE_S
        while self.exit_status(0) is None:
            if self.has_ended() or time.monotonic() > deadline:
                raise self._start_failure()
            wait([self.status_descriptor], 0.1)

    def _start_failure(self) -> SandboxFailed:
        self._process.kill()
        self._process.wait()
        self.output.read_available()
        said = self.output.text().strip()
        if self._kind is IsolationKind.VM:
            said = said or gvisor.read_failure(self._bundle)
        return SandboxFailed(
            f"The sandbox ({self._kind}) did not start ({said or 'nothing was printed'}); run `vitac doctor`, which "
            "says what is missing."
        )

    def _start_watchdog(self) -> MemoryWatchdog | None:
        if self._group is not None:
            return None
        watchdog = MemoryWatchdog(self.first_pid, memory_bytes=self.limits.memory_bytes)
        return self._exits.enter_context(watchdog)

    def _stop(self, ours: socket.socket) -> None:
        """Kill all processes and wait for their end; then nothing holds the output's other end.

        Raises:
            SandboxFailed: something survived.
        """
        with contextlib.suppress(ProcessLookupError, AttributeError):
            kill = os.killpg if self._kind is IsolationKind.NONE else os.kill  # it leads a group of its own
            kill(self.first_pid, signal.SIGKILL)
            # bubblewrap waits for the first process and then ends. Killed before, it would leave a zombie to whoever
            # collects orphans here, and RLIMIT_NPROC counts zombies of the policy's user.
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_DEADLINE_S)
        self._process.kill()
        self._process.wait()
        ours.close()  # Unread messages in it may hold descriptors of the output that the policy has sent along.
        deadline = time.monotonic() + _STOP_DEADLINE_S
        while not self.output.is_closed:
            if time.monotonic() > deadline:
                raise SandboxFailed("Processes of a sandbox survived its end; look for them and restart the worker.")
            wait([self.output.fileno()], 0.1)
            self.output.read_available()

    def _watchdog_kills(self) -> int:
        return self._watchdog.kills if self._watchdog is not None else 0

    def _processes_at_limit(self) -> int:
        return int(sum(1 for _ in process_tree.descendants(self.first_pid)) >= self.limits.processes)


def _spawn(
    command: list[str], source: int, output: int, errors: int, passed: Sequence[int]
) -> "subprocess.Popen[bytes]":
    try:
        return subprocess.Popen(  # noqa: S603 - the command holds paths of ours only
            command, stdin=source, stdout=output, stderr=errors, pass_fds=passed, env={}, cwd="/"
        )
    except OSError as error:
        raise SandboxFailed(f"The sandbox could not be started: {error}; run `vitac doctor`.") from error


def _proc_name(descriptor: int, resource: str) -> str:
    return f"{resource}:[{os.fstat(descriptor).st_ino}]"


def unisolated_command(folder: Path, *, submission: Path, limits: Limits) -> list[str]:
    """Return the command line, and put our files, which lie beside each other in a sandbox, into a folder.

    Args:
        folder: empty, stays for as long as the policy runs.
        submission: folder of the policy.
        limits: what the policy may use.
    """
    for outside, inside in bubblewrap.OWN_FILES:
        shutil.copy(outside, folder / Path(inside).name)
    return bubblewrap.runtime_command(
        limits,
        program=Path(sys.executable),
        packages=package_folders(),
        runtime=str(folder / Path(bubblewrap.INSIDE_RUNTIME).name),
        submission=str(submission.resolve()),
    )


def unisolated_environment() -> dict[str, str]:
    """Return the environment variables of a sandbox, with this machine's own places."""
    kept = {name: os.environ[name] for name in ("HOME", "PATH", "TMPDIR", "LD_LIBRARY_PATH") if name in os.environ}
    return {**bubblewrap.ENVIRONMENT, **kept}
