"""Chooses the folder for database, files and keys when `VITAC_STATE_DIR` is not set.

As root the database runs as `nobody`, so every folder above must let other users through; the root home does not.
"""

import hashlib
import os
import stat
from importlib.util import find_spec
from pathlib import Path

SYSTEM_STATE = Path("/var/lib/vitac-arena")


def default_state_directory() -> Path:
    """Return `.state` of the checkout, else the user's state folder; for root, one in /var/lib where that is needed."""
    return choose_state_directory(
        checkout=checkout_directory(), user_state=_user_state(), is_root=os.geteuid() == 0, system_state=SYSTEM_STATE
    )


def choose_state_directory(*, checkout: Path | None, user_state: Path, is_root: bool, system_state: Path) -> Path:
    """Return the rule behind `default_state_directory`, with all that it depends on passed in."""
    wanted = checkout / ".state" if checkout is not None else user_state / "vitac-arena"
    if not is_root or others_can_enter(wanted.parent):
        return wanted
    if checkout is None:
        return system_state / "default"
    return system_state / hashlib.sha256(str(checkout).encode()).hexdigest()[:12]


def others_can_enter(folder: Path) -> bool:
    """Return whether a user who owns nothing can reach this folder: all above have their x bit for others."""
    existing = [path for path in (folder, *folder.parents) if path.exists()]
    return all(path.stat().st_mode & stat.S_IXOTH for path in existing)


def checkout_directory() -> Path | None:
    """Return the source tree that this package runs from, or None when it was installed from a wheel."""
    spec = find_spec("vitac.server")
    if spec is None or spec.origin is None:
        return None
    root = Path(spec.origin).resolve().parent.parent
    is_checkout = (root / "pyproject.toml").is_file() and (root / "migrations").is_dir()
    return root if is_checkout and os.access(root, os.W_OK) else None


def _user_state() -> Path:
    configured = os.environ.get("XDG_STATE_HOME", "")
    return Path(configured) if configured.startswith("/") else Path.home() / ".local" / "state"
