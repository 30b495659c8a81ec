"""Runs inside the sandbox as its first process: loads the policy and answers the evaluator's questions.

Only the standard library, NumPy and `back_projection`, which needs NumPy only, are imported. Started as
`python agent.py CPU_SOFT_S CPU_HARD_S SUBMISSION PACKAGES...`, with the channel and a pipe for reports open.
Nothing here is relied upon for safety: after the policy is imported it owns this code too, and the evaluator checks
every byte that it sends. Three processes take part:

- *first*: process 1 of the sandbox; never runs a line of the policy, reports how its children end;
- *loader*: imports the policy and calls its constructor;
- *loaded copy*: forked from the loader so that it has one thread only; it waits for the first question of an episode.
  The evaluator copies it for every episode, or lets it continue itself where copying is not possible.
"""

import contextlib
import errno
import faulthandler
import fcntl
import functools
import gc
import importlib
import io
import itertools
import json
import math
import os
import resource
import runpy
import signal
import socket
import stat
import struct
import sys
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any, NoReturn

PREFIX = struct.Struct("<4sIQ")
MAGIC = b"VTC1"
STATUS = struct.Struct("<ii")
MESSAGE_MAX_CHARS = 2000
DTYPES = {"u1": "u1", "u2": "<u2", "i2": "<i2", "i4": "<i4", "i8": "<i8", "f4": "<f4", "f8": "<f8", "b1": "b1"}
BACK_PROJECTION = Path(__file__).with_name("back_projection.py")
NAMES_SHOWN = 20
WHEELS_FOLDER = "site-packages"  # of the submission, with the files of its wheels
LOADER = 2  # pid of the loader in a sandbox, and its name in reports elsewhere
CHANNEL, REPORTS = 3, 4  # descriptors, whatever the evaluator has open
PIPE_NUMBERS = itertools.count()
FORK_ERRORS = ("can't start new thread", "Resource temporarily unavailable")


class Refused(Exception):
    """The policy cannot continue; carries the verdict's code and the sentence for its team."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.message = message


class Connection:
    """This end of the channel; one question is read, one answer is written."""

    def __init__(self, descriptor: int) -> None:
        self._socket = socket.socket(fileno=descriptor)
        self._seq = 0

    def read(self) -> tuple[str, str, dict[str, Any]]:
        """Return kind, text and arrays of the next question."""
        _, header_bytes, payload_bytes = PREFIX.unpack(self._read_exactly(PREFIX.size))
        header = json.loads(self._read_exactly(header_bytes))
        payload = self._read_exactly(payload_bytes)
        self._seq = header["seq"]
        # The first question has none: no NumPy is imported before the policy, which may bring its own.
        arrays = decode_arrays(header["arrays"], payload) if header["arrays"] else {}
        add_clouds(header["clouds"], arrays)
        return header["kind"], header["text"], arrays

    def write(self, kind: str, *, numbers: Any = None, code: str = "", message: str = "") -> None:
        """Answer the last question, with an array of the kind's name where there are numbers."""
        specs: list[dict[str, Any]] = []
        payload = b""
        if numbers is not None:
            payload = numbers.tobytes()
            dtype = f"{numbers.dtype.kind}{numbers.dtype.itemsize}"
            specs.append({"name": kind, "dtype": dtype, "shape": list(numbers.shape)})
        answer = {"seq": self._seq, "kind": kind, "code": code, "message": message, "arrays": specs}
        header = json.dumps(answer).encode("ascii", "replace")
        self._socket.sendall(PREFIX.pack(MAGIC, len(header), len(payload)) + header + payload)

    def _read_exactly(self, n_bytes: int) -> bytearray:
        data = bytearray(n_bytes)
        view = memoryview(data)
        while view:
            read = self._socket.recv_into(view)
            if read == 0:
                os._exit(0)  # the evaluator has gone
            view = view[read:]
        return data


def decode_arrays(specs: list[dict[str, Any]], payload: bytearray) -> dict[str, Any]:
    """Return the arrays of a question: writeable, native, owned by the policy."""
    import numpy as np

    arrays = {}
    offset = 0
    for spec in specs:
        flat = np.frombuffer(payload, dtype=DTYPES[spec["dtype"]], count=math.prod(spec["shape"]), offset=offset)
        arrays[spec["name"]] = flat.reshape(spec["shape"])
        offset += flat.nbytes
    return arrays


def add_clouds(specs: list[dict[str, Any]], arrays: dict[str, Any]) -> None:
    """Make the point clouds of a question out of its depth pictures; a picture that is not read is taken out."""
    for spec in specs:
        arrays[spec["name"]] = point_cloud()(arrays[spec["depth"]], spec["intrinsics"])
    for spec in specs:
        if not spec["keep_depth"]:
            del arrays[spec["depth"]]


@functools.cache
def point_cloud() -> Any:
    """Return the environments' own function, whose file lies beside this one in the sandbox."""
    return runpy.run_path(str(BACK_PROJECTION))["point_cloud"]


def as_numbers(value: Any, what: str = "act()") -> Any:
    """Return the policy's answer as an array that the channel carries; shape and values are judged outside."""
    import numpy as np

    if isinstance(value, (bytes, str, dict)) or value is None:
        raise Refused("bad_action_type", f"{what} returned {type(value).__name__}, expected an array of real numbers.")
    try:
        array = np.asanyarray(value)
    except Exception as error:
        raise Refused(
            "bad_action_type", f"{what} returned what NumPy cannot make an array of: {error!r:.500}"
        ) from error
    if array.dtype.kind not in "fiu":
        raise Refused("bad_action_type", f"{what} returned an array of dtype {array.dtype}, expected real numbers.")
    if hasattr(array, "mask"):  # asking for numpy.ma would load it, which takes 50 ms
        raise Refused("bad_action_type", f"{what} returned a masked array, expected real numbers without a mask.")
    if array.size > 4096:
        raise Refused("bad_action_shape", f"{what} returned an array of shape {array.shape}, far larger than expected.")
    return np.ascontiguousarray(array, dtype="<f4" if array.dtype == np.float32 else "<f8").reshape(array.shape)


def verdict_code(error: BaseException, otherwise: str) -> str:
    """Return the verdict that an exception of the policy amounts to."""
    if isinstance(error, MemoryError):
        return "out_of_memory"
    if isinstance(error, (OSError, RuntimeError)) and any(part in str(error) for part in FORK_ERRORS):
        return "too_many_processes"
    return otherwise


def no_hint(_: BaseException) -> str:
    """Add nothing to what an exception says."""
    return ""


def guarded(otherwise: str, what: str, call: Callable[[], Any], hint: Callable[[BaseException], str] = no_hint) -> Any:
    """Run a piece of the policy; whatever it raises, SystemExit included, becomes a named refusal.

    Args:
        otherwise: verdict of an exception that has none of its own.
        what: names the piece.
        call: the piece.
        hint: what to say after the exception, from a space on.
    """
    try:
        return call()
    except Refused:
        raise
    except BaseException as error:  # noqa: BLE001 - a policy may raise anything
        print_traceback(error)
        summary = f"{what} raised {type(error).__name__}: {error}"
        with contextlib.suppress(BaseException):  # a hint may run into the policy's modules
            summary += hint(error)
        raise Refused(verdict_code(error, otherwise), summary[:MESSAGE_MAX_CHARS]) from None


def print_traceback(error: BaseException) -> None:
    """Tell the team where its code failed, from its first line on, unless the policy has closed its output."""
    with contextlib.suppress(Exception):
        place = error.__traceback__
        while place is not None and is_way_to_policy(place.tb_frame.f_code.co_filename):
            place = place.tb_next
        traceback.print_exception(type(error), error, place, limit=-30)


def is_way_to_policy(file: str) -> bool:
    """Return whether a line of a file leads to the policy's code: ours, or Python's own import."""
    return file in (__file__, importlib.__file__) or file.startswith("<frozen importlib")


def list_available(error: BaseException, submission: str, module_name: str) -> str:
    """Return the files and packages that there are, for a policy that asks for one that is not there."""
    if not isinstance(error, (ModuleNotFoundError, FileNotFoundError)):
        return ""
    files = sorted(str(file.relative_to(submission)) for file in Path(submission).rglob("*") if file.is_file())
    hint = f". Files in the submission: {', '.join(files[:NAMES_SHOWN])}"
    hint += f" and {len(files) - NAMES_SHOWN} more" if len(files) > NAMES_SHOWN else ""
    if isinstance(error, FileNotFoundError) or error.name == module_name.partition(".")[0]:
        return hint + "."
    wheels = f"{submission}/{WHEELS_FOLDER}"
    # A file there may have the name of Python's own.
    sys.path[:] = [place for place in sys.path if place not in {submission, wheels}]
    import difflib  # late, as below, and only with Python's own folders on the path

    packages = [each.partition(" ")[0] for each in installed_packages(wheels)]
    near = difflib.get_close_matches(error.name or "", packages, NAMES_SHOWN)
    like = f" (names like it: {', '.join(near)})" if near else ""
    return f"{hint}. None of the {len(packages)} installed packages has it{like}; `vitac sandbox` lists them."


def list_classes(module: Any) -> str:
    """Return the classes that a policy's module makes, for an entry point that names another."""
    classes = {name: each for name, each in vars(module).items() if isinstance(each, type)}
    made = sorted(name for name, each in classes.items() if each.__module__ == module.__name__)
    return f". Classes there: {', '.join(made[:NAMES_SHOWN]) or 'none'}."


def installed_packages(*further: str) -> list[str]:
    """Return name and version of the packages that a policy can import, with those of further folders."""
    import importlib.metadata  # late: it would make every copy of the policy slower to start

    installed = importlib.metadata.distributions(path=[*sys.path, *further])
    versions = {(each.metadata["Name"] or "").lower(): each.version for each in installed}
    return [f"{name} {versions[name]}" for name in sorted(versions.keys() - {"", "vitac-arena"})]


def load(entry_point: str, submission: str) -> Any:
    """Import `module:Class` from the submission and call it."""
    sys.path[:0] = [submission, f"{submission}/{WHEELS_FOLDER}"]
    os.chdir(submission)
    module_name, _, class_name = entry_point.partition(":")
    hint = partial(list_available, submission=submission, module_name=module_name)
    module = guarded("import_error", f"Importing {module_name}", lambda: importlib.import_module(module_name), hint)
    looking_up = f"Looking up {class_name} in {module_name}"
    make = guarded("import_error", looking_up, lambda: getattr(module, class_name), lambda _: list_classes(module))
    return guarded("load_failed", f"{class_name}()", make, hint)


def answer_episode(policy: Any, connection: Connection) -> None:
    """Answer the questions of one episode, until the evaluator ends this process."""
    while True:
        kind, text, arrays = connection.read()
        if kind == "reset":
            guarded("crashed", "reset()", partial(methodcaller("reset", text), policy))
            connection.write("ready")
        elif kind == "believe":
            answer_belief(policy, connection)
        else:
            action = guarded("crashed", "act()", partial(methodcaller("act", arrays), policy))
            connection.write("action", numbers=as_numbers(action))


def answer_belief(policy: Any, connection: Connection) -> None:
    """Send what the policy believes, or why it cannot be sent: the episode continues in both cases."""
    try:
        connection.write("belief", numbers=read_belief(policy))
    except Refused as refusal:
        connection.write("failed", code=refusal.code, message=refusal.message)


def read_belief(policy: Any) -> Any:
    """Return what the policy believes, None where it has no such method or knows nothing."""

    def believed_now() -> Any:
        believe = getattr(policy, "belief", None)
        return believe() if callable(believe) else None

    believed = guarded("crashed", "belief()", believed_now)
    return None if believed is None else as_numbers(believed, "belief()")


def run_loader(connection: Connection, submission: str, *, alone: bool) -> None:
    """Load the policy, then continue as a copy that has only one thread; outside of a sandbox as this process."""
    _, entry_point, _ = connection.read()
    if not alone:
        os.pipe, os.statvfs = open_pipe, describe_room
        try:
            for end in socket.socketpair():
                end.close()
        except OSError:  # on the machine's own kernel
            socket.socketpair = open_pair  # type: ignore[assignment]
    policy = load(entry_point, submission)
    point_cloud()  # now, so that no episode has to read it, and after the policy, as it imports NumPy
    gc.freeze()  # collections in the copies then leave what was loaded alone, which they would copy otherwise
    if not alone:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            pid = os.fork()
        if pid:
            os._exit(0)
    connection.write("loaded", message=str(LOADER if alone else os.getpid()))
    answer_episode(policy, connection)


def run_policy_side(connection: Connection, submission: str, *, alone: bool) -> NoReturn:
    """Return everything in which code of the policy runs."""
    try:
        run_loader(connection, submission, alone=alone)
    except Refused as refusal:
        flush_output()
        connection.write("failed", code=refusal.code, message=refusal.message)
    except BaseException as error:  # noqa: BLE001 - a policy may have broken anything in this process
        print_traceback(error)
        flush_output()
        os._exit(1)
    os._exit(0)


def flush_output() -> None:
    """Push out what the policy has printed; it may have closed or replaced its streams."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except Exception:  # noqa: BLE001, S112 - nothing that a policy does to its streams may hide its verdict
            continue


def report_children(status: int, loader: int) -> None:
    """Tell the evaluator how each process of the sandbox ended, until there is none left."""
    while True:
        try:
            pid, wait_status = os.wait()
        except ChildProcessError:
            return
        os.write(status, STATUS.pack(LOADER if pid == loader else pid, wait_status))


def open_pipe() -> tuple[int, int]:
    """Stand in for `os.pipe`: the kernel's own pipes have numbers that count those of the whole machine."""
    name = f"/tmp/.pipe-{os.getpid()}-{next(PIPE_NUMBERS)}"  # noqa: S108 - the sandbox's own tmpfs
    os.mkfifo(name, 0o600)
    read = os.open(name, os.O_RDONLY | os.O_NONBLOCK)
    write = os.open(name, os.O_WRONLY)
    os.unlink(name)  # noqa: PTH108 - a Path takes several times as long
    os.set_blocking(read, True)
    return read, write


class PairEnd(io.FileIO):
    """One end of a pipe, with what an event loop of `asyncio` calls of a socket."""

    recv = io.FileIO.read
    send = io.FileIO.write

    def setblocking(self, flag: bool) -> None:
        """Choose whether calls wait."""
        os.set_blocking(self.fileno(), flag)

    def detach(self) -> int:
        """Refuse: who takes the descriptor, as `multiprocessing.Pipe` does, would write to both ends."""
        raise OSError(
            errno.ENOSYS, "Expected a pipe of one direction, as Pipe(duplex=False): there are no sockets here"
        )


def open_pair(*_: Any, **__: Any) -> tuple[PairEnd, PairEnd]:
    """Stand in for `socket.socketpair`, by which event loops wake themselves: an end that reads, one that writes."""
    read, write = open_pipe()
    return PairEnd(read, "r"), PairEnd(write, "w")


def describe_room(path: object) -> os.statvfs_result:
    """Stand in for `os.statvfs`, which would show what others store; `multiprocessing` asks it of /dev/shm."""
    os.stat(path)  # type: ignore[arg-type]  # noqa: PTH116 - raises as the call would
    blocks = 16 << 8
    return os.statvfs_result((4096, 4096, blocks, blocks, blocks, blocks, blocks, blocks, 0, 255))


def take_descriptors() -> None:
    """Make the only socket CHANNEL and the only pipe REPORTS, and close what else is open but the standard streams.

    On the command line, which the policy can read, their numbers would say what the evaluator has open.
    """
    found = [first_descriptor(is_kind) for is_kind in (stat.S_ISSOCK, stat.S_ISFIFO)]
    channel, reports = (fcntl.fcntl(descriptor, fcntl.F_DUPFD, REPORTS + 1) for descriptor in found)
    os.dup2(channel, CHANNEL)
    os.dup2(reports, REPORTS)
    os.closerange(REPORTS + 1, 1 << 16)


def first_descriptor(is_kind: Callable[[int], bool]) -> int:
    """Return the first descriptor above the standard streams whose file's mode is of this kind."""
    for descriptor in itertools.count(CHANNEL):
        with contextlib.suppress(OSError):
            if is_kind(os.fstat(descriptor).st_mode):
                return descriptor
    raise AssertionError


def main(arguments: list[str]) -> None:
    """Fork the loader and report how the sandbox's processes end."""
    cpu_limits, submission, packages = (int(arguments[0]), int(arguments[1])), arguments[2], arguments[3:]
    # What the machine's own Python has installed besides would differ from machine to machine.
    sys.path[:] = [*packages, *(folder for folder in sys.path if not folder.endswith("-packages"))]
    sys.argv = ["policy"]
    take_descriptors()
    alone = os.getpid() != 1  # without a sandbox
    pid = os.fork()
    if pid == 0:
        os.close(REPORTS)
        resource.setrlimit(resource.RLIMIT_CPU, cpu_limits)
        faulthandler.enable()
        run_policy_side(Connection(CHANNEL), submission, alone=alone)
    os.close(CHANNEL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the only signal that Python gives process 1 a handler for
    os.write(REPORTS, STATUS.pack(0, 0))  # the sandbox works: from here on a failure is the policy's
    report_children(REPORTS, pid)


if __name__ == "__main__":
    main(sys.argv[1:])
