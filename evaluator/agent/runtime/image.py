"""Runs inside the sandbox as its first process, in place of `agent`: enters a container image and runs its command.

Only the standard library is imported. Started as `python image.py CPU_SOFT_S CPU_HARD_S ORDER ...`, otherwise as
`agent` is. This process stays outside of the image and reports how its child ends. The child enters the image, gives up
every right, and becomes the command, which answers the evaluator's questions on the channel (docs/policy-protocol.md).
"""

import ctypes
import json
import os
import resource
import signal
import struct
import sys
from pathlib import Path
from typing import Any, NoReturn

sys.path.insert(0, str(Path(__file__).parent))
from agent import CHANNEL, REPORTS, STATUS, report_children, take_descriptors  # type: ignore[attr-defined]  # beside this file

CAPABILITY_VERSION = 0x20080522
PR_SET_PDEATHSIG = 1
NOT_STARTED = 127


def drop_rights(uid: int | None) -> None:
    """Become the policy's user, where this is root, and give up all capabilities; both end where this process does."""
    if uid is not None:
        os.setgroups([])
        os.setresgid(uid, uid, uid)
        os.setresuid(uid, uid, uid)
    library = ctypes.CDLL(None, use_errno=True)
    if library.capset(struct.pack("<Ii", CAPABILITY_VERSION, 0), bytes(24)):
        raise OSError(ctypes.get_errno(), "Capabilities could not be given up")
    library.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # which the change of the user has cleared


def become_command(order: dict[str, Any]) -> NoReturn:
    """Enter the image and run its command."""
    os.chroot(order["root"])
    os.chdir("/")
    drop_rights(order["uid"])
    for number in (signal.SIGPIPE, signal.SIGXFSZ):  # which Python ignores
        signal.signal(number, signal.SIG_DFL)
    arguments = order["arguments"]
    try:
        os.chdir(order["folder"])
        os.execvpe(arguments[0], arguments, order["variables"])  # noqa: S606 - the policy, in its sandbox
    except OSError as error:
        place = order["folder"]
        sys.stderr.write(f"The image's command {arguments[0]!r} cannot be run in {place!r}: {error.strerror}.\n")
    sys.stderr.flush()
    os._exit(NOT_STARTED)


def main(arguments: list[str]) -> None:
    """Start the command and report how the sandbox's processes end."""
    order = json.loads(arguments[2])
    take_descriptors()
    pid = os.fork()
    if pid == 0:
        os.close(REPORTS)
        resource.setrlimit(resource.RLIMIT_CPU, (int(arguments[0]), int(arguments[1])))
        become_command(order)
    os.close(CHANNEL)
    drop_rights(order["uid"])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the only signal that Python gives process 1 a handler for
    os.write(REPORTS, STATUS.pack(0, 0))  # the sandbox works: from here on a failure is the policy's
    report_children(REPORTS, pid)


if __name__ == "__main__":
    main(sys.argv[1:])
