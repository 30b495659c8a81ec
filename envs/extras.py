"""Optional extras of the package: the command that installs one, for errors that name what is missing."""

import sys
from importlib.metadata import requires
from importlib.util import find_spec
from shlex import quote


def install_command(extra: str) -> str:
    """Return the command that installs the packages of an extra into this Python; one of uv may have no pip."""
    wanted = [line.split(";")[0].strip() for line in requires("vitac-arena") or () if f'extra == "{extra}"' in line]
    python = quote(sys.executable)
    installer = f"{python} -m pip install" if find_spec("pip") else f"uv pip install --python {python}"
    return f"{installer} {' '.join(quote(package) for package in wanted)}"
