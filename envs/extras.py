"""Optional extras of the package: which one has a module, and the command that installs it.

Called where something of an extra is used, and by the command line for whatever is missing elsewhere.
"""

import re
import sys
from importlib.metadata import requires
from importlib.util import find_spec
from shlex import quote

from vitac.errors import VitacError

_DISTRIBUTIONS = {
    "PIL": "pillow",
    "argon2": "argon2-cffi",
    "cv2": "opencv-python-headless",
    "grpc": "grpcio",
    "h11": "uvicorn",
    "h5py": "minari",
    "markdown_it": "markdown-it-py",
    "markupsafe": "jinja2",
    "multipart": "python-multipart",
    "opentelemetry": "opentelemetry-sdk",
    "serial": "pyserial",
    "starlette": "fastapi",
}
"""By module, where the names differ; of what comes with another package, that one."""


class ExtraMissing(VitacError):
    """Something needs packages of an extra that is not installed; the message says how to install them."""


def install_command(extra: str) -> str:
    """Return the command that installs the packages of an extra into this Python; one of uv may have no pip."""
    python = quote(sys.executable)
    installer = f"{python} -m pip install" if find_spec("pip") else f"uv pip install --python {python}"
    return f"{installer} {' '.join(quote(package) for package in _requirements().get(extra, ()))}"


def find_extra(module: str, preferred: str | None = None) -> str | None:
    """Return the extra that installs a module: the preferred one if it does, else the smallest; None if none does."""
    package = module.partition(".")[0]
    wanted = _DISTRIBUTIONS.get(package, package.replace("_", "-")).lower()
    extras = {name: packages for name, packages in _requirements().items() if wanted in map(_name, packages)}
    return preferred if preferred in extras else min(extras, key=lambda name: len(extras[name]), default=None)


def require_extra(extra: str, *modules: str, user: str = "This command") -> None:
    """Check that modules of an extra can be imported, before a process is started that needs them.

    Args:
        extra: which has them.
        modules: names of the modules.
        user: what needs them, as a sentence begins.

    Raises:
        ExtraMissing: one is not installed.
    """
    for module in modules:
        if find_spec(module) is None:
            raise ExtraMissing(explain_missing(module, extra, user))


def explain_missing(module: str, extra: str, user: str = "This command") -> str:
    """Return the sentences that say what is missing and how to install it."""
    return f"{module} is not installed. {user} needs the extra {extra!r}; install it with: {install_command(extra)}"


def _requirements() -> dict[str, list[str]]:
    """Return what each extra installs, without that of developers."""
    by_extra: dict[str, list[str]] = {}
    for line in requires("vitac-arena") or ():
        requirement, _, marker = line.partition(";")
        if (extra := re.search(r"extra == ['\"](.+?)['\"]", marker)) and extra[1] not in ("dev", "compat"):
            by_extra.setdefault(extra[1], []).append(requirement.strip())
    return by_extra


def _name(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement, maxsplit=1)[0].lower().replace("_", "-")
