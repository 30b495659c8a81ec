"""The root of every error that ViTac Arena raises on purpose, and one that must be known before physics is loaded."""

import os


class VitacError(Exception):
    """Something was asked that cannot be done; the message says what was expected, what was given and what to do."""


class CompilationDisabled(VitacError):
    """Numba may not compile in this process, and the physics exists only compiled; unset the variable."""


def require_compilation() -> None:
    """Refuse to load the physics where Numba was told not to compile.

    Raises:
        CompilationDisabled: NUMBA_DISABLE_JIT is set.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0").strip() not in ("", "0"):
        raise CompilationDisabled(
            "NUMBA_DISABLE_JIT is set, but the physics exists only compiled. Unset it and run the command again: "
            "unset NUMBA_DISABLE_JIT"
        )
