"""Tries to break out of this machine's own sandbox. Called by `vitac doctor` and by workers, before they start.

Each probe is an attempt of a small hostile policy. It answers with the number of things it reached, or meets a verdict.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Final, Self

import numpy as np

from ..isolation_kinds import IsolationKind
from .isolation.memory_files import FileIsolation, default_file_isolation
from .isolation.seccomp import call_numbers
from .limits import MIB, Limits
from .probe_folder import probe_folder
from .session import ISOLATION_VARIABLE, Isolation, PolicySession, default_kind
from .verdicts import PolicyFailed, SandboxFailed, VerdictCode

CANARY: Final = "vitac-canary-7c1d"
_LIMITS: Final = Limits(
    memory_bytes=256 * MIB, action_cpu_s=20.0, action_wall_s=30.0, episode_cpu_s=30.0, output_killed_bytes=MIB
)
"""Much CPU time: on a busy machine it takes a second to fill the memory."""
_TOO_SLOW: Final = frozenset(
    {VerdictCode.START_TIMEOUT, VerdictCode.CPU_TIME, VerdictCode.WALL_TIME, VerdictCode.SHARD_TIME}
)
"""Verdicts of an overloaded machine."""
_OBSERVATION: Final = {"value": np.zeros(1, dtype=np.float32)}
_EPISODES: Final = 2


class ProbeState(StrEnum):
    """How a probe ended."""

    HELD = "held"
    ESCAPED = "escaped"
    FAILED = "could not be tested"
    """The sandbox could not be started, or the machine was too slow for the attempt."""


@dataclass(frozen=True, kw_only=True)
class Probe:
    """One attempt."""

    name: str
    code: str
    """Body of `attempt()`, which returns how many things were reached. CANARY_FILE is a file of the evaluator's."""
    verdict: VerdictCode | None = None
    """What has to end it; None where it has to end well and reach nothing."""
    needs_memory: bool = False
    """Whether it can hold only where policies' files lie in memory."""
    is_of_namespaces: bool = False
    """Whether it attacks the machine's kernel, in whose place a policy under `vm` has its own."""
    limits: Limits = _LIMITS


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Check result of one probe."""

    name: str
    state: ProbeState
    detail: str
    isolation: Isolation | None


_TEMPLATE: Final = """
import ctypes, fcntl, os, signal, socket, time

CANARY_FILE = {canary_file!r}
PARENT = {parent}
CALLS = {calls}
SYSCALL = ctypes.CDLL(None, use_errno=True).syscall


def reached(*attempts):
    count = 0
    for attempt in attempts:
        try:
            attempt()
            count += 1
        except (OSError, ImportError):
            pass
    return count


def allowed(*calls):
    return sum(SYSCALL(*map(ctypes.c_long, (CALLS[name], *rest))) >= 0 for name, *rest in calls)


class Policy:
    memory = 0

    def reset(self, task):
        self.attempt = ATTEMPTS[task]

    def act(self, observation):
        return [self.attempt()]


ATTEMPTS = {{}}
"""
_CALLS: Final = """
    socketpair ptrace process_vm_readv process_vm_writev pidfd_getfd unshare setns open_tree chroot bpf io_uring_setup
    perf_event_open keyctl memfd_create userfaultfd sync landlock_create_ruleset setuid setgid reboot statfs fstatfs
    inotify_init1 mincore readahead syncfs fanotify_init quotactl
"""
"""System calls that attempts make by `allowed`, since Python has no function for them."""
_ATTEMPT: Final = """

def attempt():
{body}


ATTEMPTS[{name!r}] = attempt
"""

PROBES: Final = (
    Probe(name="a policy can answer", code="return 0"),
    Probe(
        name="network out of reach",
        code="""
def connect(family, address):
    with socket.socket(family) as sock:
        sock.settimeout(1)
        sock.connect(address)

return reached(
    lambda: connect(socket.AF_INET, ("127.0.0.1", 22)),
    lambda: connect(socket.AF_INET, ("192.0.2.1", 80)),
    lambda: connect(socket.AF_INET6, ("::1", 22)),
    lambda: socket.getaddrinfo("example.org", 80),
)""",
    ),
    Probe(
        name="sockets refused",
        is_of_namespaces=True,
        code="""
numbers = ctypes.create_string_buffer(8)
return allowed(("socketpair", 1, 1, 0, ctypes.addressof(numbers))) + reached(
    lambda: socket.socket(socket.AF_INET),
    lambda: socket.socket(socket.AF_INET6),
    lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW),
)""",
    ),
    Probe(
        name="files hidden",
        code="""
return reached(
    lambda: open(CANARY_FILE).read(),
    lambda: os.listdir(os.path.dirname(CANARY_FILE)),
    lambda: open("/etc/shadow").read(),
    lambda: os.listdir("/root"),
    lambda: os.listdir("/home"),
    lambda: open(f"/proc/{PARENT}/environ").read(),
    lambda: __import__("vitac.evaluator"),
)""",
    ),
    Probe(
        name="kernel's files hidden",
        is_of_namespaces=True,
        code="""
return reached(lambda: os.listdir("/proc"), lambda: os.listdir("/sys"))""",
    ),
    Probe(
        name="files cannot be changed",
        code="""
return reached(
    lambda: open("/submission/new", "w"),
    lambda: open("/usr/new", "w"),
    lambda: open("/etc/passwd", "w"),
    lambda: open("/dev/new", "w"),
    lambda: open("/opt/vitac/agent.py", "a"),
)""",
    ),
    Probe(
        name="environment empty",
        code=f"""
found = [name for name in os.environ if name in ("USER", "LOGNAME", "SHELL")]
return len(found) + sum("{CANARY}" in value for value in os.environ.values())""",
    ),
    Probe(
        name="fork bomb capped",
        # The first process fails when it is refused. The others sleep: they would else use up the CPU time before that.
        code="""
first = os.getpid()
while reached(os.fork):
    pass
if os.getpid() == first:
    os.fork()
time.sleep(60)""",
        verdict=VerdictCode.TOO_MANY_PROCESSES,
        # Memory for all processes that the limit allows.
        limits=replace(_LIMITS, memory_bytes=1024 * MIB, action_wall_s=5.0),
    ),
    Probe(
        name="memory of one process capped",
        code="kept = [bytearray(os.urandom(1 << 20)) * 16 for _ in range(100)]\nreturn len(kept)",
        verdict=VerdictCode.OUT_OF_MEMORY,
    ),
    Probe(
        name="memory of many processes capped",
        code="""
for _ in range(12):
    if os.fork() == 0:
        kept = bytearray(os.urandom(1 << 20)) * 40
        time.sleep(60)
time.sleep(60)""",
        verdict=VerdictCode.OUT_OF_MEMORY,
    ),
    Probe(
        name="CPU time capped",
        code="while True:\n    pass",
        verdict=VerdictCode.CPU_TIME,
        limits=replace(_LIMITS, action_cpu_s=0.5),
    ),
    Probe(
        name="wall time capped",
        code="time.sleep(60)",
        verdict=VerdictCode.WALL_TIME,
        limits=replace(_LIMITS, action_wall_s=0.5),
    ),
    Probe(name="output capped", code='while True:\n    os.write(1, b"x" * 4096)', verdict=VerdictCode.OUTPUT_FLOOD),
    Probe(
        name="temporary files capped",
        code="""
def fill():
    for number in range(100):
        with open(f"/tmp/{number}", "wb") as file:
            file.write(bytes(1 << 20))
return reached(fill)""",
    ),
    Probe(
        name="tracing and foreign memory denied",
        code="""
return allowed(
    ("ptrace", 16, 1, 0, 0),
    ("process_vm_readv", 1, 0, 0, 0, 0, 0),
    ("process_vm_writev", 1, 0, 0, 0, 0, 0),
    ("pidfd_getfd", 0, 0, 0),
)""",
    ),
    Probe(
        name="new namespaces and mounts denied",
        is_of_namespaces=True,
        code="""
return allowed(
    ("unshare", 0x10000000), ("unshare", 0x40000000), ("setns", 0, 0), ("open_tree", -100, 0, 1), ("chroot", 0)
)""",
    ),
    Probe(
        name="kernel interfaces denied",
        is_of_namespaces=True,
        code="""
return allowed(
    ("bpf", 5, 0, 0),
    ("io_uring_setup", 8, 0),
    ("perf_event_open", 0, 0, -1, -1, 0),
    ("keyctl", 0, 0, 0),
    ("memfd_create", 0, 0),
    ("userfaultfd", 1),
    ("sync",),
    ("landlock_create_ruleset", 0, 0, 1),
)""",
    ),
    Probe(
        name="no rights of root",
        code='return (os.getuid() == 0) + allowed(("setuid", 0), ("setgid", 0), ("reboot", 0, 0, 0))',
    ),
    Probe(
        name="room for files tells nothing",
        code="""
file = open("/usr/bin/env", "rb")
place = ctypes.create_string_buffer(b"/usr")
room = ctypes.create_string_buffer(256)
return allowed(
    ("statfs", ctypes.addressof(place), ctypes.addressof(room)), ("fstatfs", file.fileno(), ctypes.addressof(room))
)""",
    ),
    Probe(
        name="shared files tell nothing",
        is_of_namespaces=True,
        code="""
file = open("/usr/bin/env", "rb")
return reached(
    lambda: fcntl.flock(file, fcntl.LOCK_SH),
    lambda: fcntl.lockf(file, fcntl.LOCK_SH),
    lambda: fcntl.fcntl(file, fcntl.F_GETLEASE),
    lambda: os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED),
) + allowed(
    ("inotify_init1", 0),
    ("mincore", 0, 0, 0),
    ("readahead", file.fileno(), 0, 4096),
    ("syncfs", file.fileno()),
    ("fanotify_init", 0, 0),
    ("quotactl", 0, 0, 0, 0),
)""",
    ),
    Probe(
        name="names tell nothing",
        needs_memory=True,
        # A name that nobody has looked up yet answers several times slower on a disk, where the kernel remembers it.
        code="""
def times(names):
    found = []
    for name in names:
        begun = time.perf_counter_ns()
        os.access(name, 0)
        found.append(time.perf_counter_ns() - begun)
    return sorted(found)[len(found) // 2]

cold = 0
for group in range(8):
    names = [f"/usr/lib/{os.urandom(8).hex()}" for _ in range(200)]
    first = times(names)
    cold += first > 1.8 * min(times(names), times(names))
return int(cold >= 6)""",
    ),
    Probe(
        name="episodes share nothing",
        code="""
seen = Policy.memory + os.path.exists("/tmp/memory") + os.path.exists("/dev/shm/memory")
Policy.memory = 1
open("/tmp/memory", "w").close()
open("/dev/shm/memory", "w").close()
return seen""",
    ),
)


def run(probes: tuple[Probe, ...] = PROBES, kind: IsolationKind | None = None) -> Iterator[Outcome]:
    """Run each probe and yield its check result; `kind` as `PolicySession` takes it.

    Raises:
        SandboxFailed: nothing isolates, by setting, or libseccomp is missing.
    """
    kind = kind or default_kind()
    if kind is IsolationKind.NONE:
        raise SandboxFailed(
            f"{ISOLATION_VARIABLE} is {kind}, with which nothing keeps a policy from this machine: only your own may "
            "run so. Leave it out, and `vitac doctor` says what is missing."
        )
    with probe_folder() as folder:
        canary = folder / "secret" / CANARY
        canary.parent.mkdir()
        canary.write_text(CANARY)
        submission = folder / "probes"
        submission.mkdir(mode=0o755)
        (submission / "policy.py").write_text(make_policy(probes, canary))
        with _Sessions(submission, kind) as sessions:
            for probe in probes:
                if probe.is_of_namespaces and kind is IsolationKind.VM:
                    continue
                if probe.needs_memory and default_file_isolation() is FileIsolation.DISK:
                    continue
                yield _run_with_canary(probe, sessions)


def has_kind(kind: IsolationKind) -> bool:
    """Return whether a policy can answer here under a kind of isolation."""
    try:
        return is_safe(list(run(PROBES[:1], kind)))
    except SandboxFailed:
        return False


def is_safe(outcomes: list[Outcome]) -> bool:
    """Return whether every probe was held."""
    return all(outcome.state is ProbeState.HELD for outcome in outcomes)


class _Sessions:
    """Gives probes their sessions: one for all that have to end well, and to each of the others one of its own."""

    def __init__(self, submission: Path, kind: IsolationKind) -> None:
        self._submission = submission
        self._kind = kind
        self._exits = ExitStack()
        self._shared: PolicySession | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._exits.close()

    @contextmanager
    def session(self, probe: Probe) -> Iterator[PolicySession]:
        """Give a session with the probe's limits.

        Raises:
            PolicyFailed: the probes do not load.
            SandboxFailed: it cannot be started.
        """
        if probe.verdict is not None or probe.limits != _LIMITS:
            with PolicySession(self._submission, limits=probe.limits, kind=self._kind) as session:
                yield session
            return
        if self._shared is None:
            self._shared = self._exits.enter_context(PolicySession(self._submission, limits=_LIMITS, kind=self._kind))
        self._shared.begin_shard()
        yield self._shared


def make_policy(probes: tuple[Probe, ...], canary: Path) -> str:
    """Return the code of a policy that makes the attempt whose name it is reset with."""
    code = _TEMPLATE.format(canary_file=str(canary), parent=os.getpid(), calls=call_numbers(_CALLS.split()))
    for probe in probes:
        body = "".join(f"    {line}\n" for line in probe.code.strip().splitlines())
        code += _ATTEMPT.format(name=probe.name, body=body)
    return code


def _run_with_canary(probe: Probe, sessions: _Sessions) -> Outcome:
    """Run a probe while the evaluator's own environment holds a secret."""
    os.environ["VITAC_CANARY"] = CANARY
    try:
        return _run(probe, sessions)
    finally:
        del os.environ["VITAC_CANARY"]


def _run(probe: Probe, sessions: _Sessions) -> Outcome:
    isolation = None
    try:
        with sessions.session(probe) as session:
            isolation = session.isolation
            reached = [_act(session, probe) for _ in range(_EPISODES)]
    except PolicyFailed as failure:
        state = _judge_verdict(failure.verdict, probe)
        detail = f"{failure.verdict}: {failure.message}"
    except SandboxFailed as error:
        state, detail = ProbeState.FAILED, str(error)
    else:
        is_held = probe.verdict is None and not any(reached)
        state = ProbeState.HELD if is_held else ProbeState.ESCAPED
        detail = "nothing was reached" if is_held else f"reached in each episode: {reached}"
    return Outcome(name=probe.name, state=state, detail=detail, isolation=isolation)


def _judge_verdict(verdict: VerdictCode, probe: Probe) -> ProbeState:
    """Return what a verdict says of the sandbox; a time limit that ended another attempt says nothing."""
    if verdict is probe.verdict:
        return ProbeState.HELD
    return ProbeState.FAILED if verdict in _TOO_SLOW else ProbeState.ESCAPED


def _act(session: PolicySession, probe: Probe) -> int:
    with session.episode(task=probe.name, action_shape=(1,)) as policy:
        return int(policy.act(_OBSERVATION)[0])
