"""Runs inside the process that becomes PostgreSQL: drops root, ties its life to the starter's, and executes.

Called as `python -I -S launch_postgres.py UID GID PARENT_PID PROGRAM ARGUMENTS...`; uses the standard library only.
"""

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def main(arguments: list[str]) -> None:
    """Become the program; never return."""
    uid, gid, parent = (int(value) for value in arguments[:3])
    if os.geteuid() == 0:
        os.setgroups([])
        os.setresgid(gid, gid, gid)
        os.setresuid(uid, uid, uid)
    # Only now: a change of user clears the death signal. SIGINT is PostgreSQL's fast shutdown.
    if ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGINT, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG) failed")
    if os.getppid() != parent:
        sys.exit("the process that started the database is gone")
    os.umask(0o077)
    os.execv(arguments[3], arguments[3:])  # noqa: S606 - becoming the program is the purpose


if __name__ == "__main__":
    main(sys.argv[1:])
