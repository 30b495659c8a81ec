"""The runtime as a process like any other, for one's own policy on a machine that cannot isolate."""

import os
import shutil
import sys
from pathlib import Path

from ..limits import Limits
from . import bubblewrap
from .packages import package_folders


def command(folder: Path, *, submission: Path, limits: Limits) -> list[str]:
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


def environment() -> dict[str, str]:
    """Return the environment variables of a sandbox, with this machine's own places."""
    kept = {name: os.environ[name] for name in ("HOME", "PATH", "TMPDIR", "LD_LIBRARY_PATH") if name in os.environ}
    return {**bubblewrap.ENVIRONMENT, **kept}
