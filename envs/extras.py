"""Optional extras of the package: the command that installs one, for errors that name what is missing."""

import sys
from importlib.metadata import requires
from shlex import quote


def install_command(extra: str) -> str:
    """Return the command that installs the packages of an extra into this Python."""
    wanted = [line.split(";")[0].strip() for line in requires("vitac-arena") or () if f'extra == "{extra}"' in line]
    return f"{sys.executable} -m pip install {' '.join(quote(package) for package in wanted)}"
