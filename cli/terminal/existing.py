"""Refuses a path of the command line that is not there, and says what is. Called by typer for arguments and options."""

from pathlib import Path

import typer


def existing(path: Path | None) -> Path | None:
    """Return the path of a file or folder; None if none was named.

    Raises:
        BadParameter: it does not exist.
    """
    if path is not None and not path.exists():
        from vitac.evaluator.submission.names import describe_contents

        raise typer.BadParameter(f"{path} does not exist; {describe_contents(path.parent)}.")
    return path


def existing_file(path: Path | None) -> Path | None:
    """Return the path of a file; None if none was named.

    Raises:
        BadParameter: it does not exist, or is a folder.
    """
    if path is not None and path.is_dir():
        from vitac.evaluator.submission.names import describe_contents

        raise typer.BadParameter(f"expected a file; {describe_contents(path)}.")
    return existing(path)
