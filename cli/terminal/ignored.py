"""Says which folders beside a submission are ignored; called by the commands that read submissions."""

import sys
from pathlib import Path


def note_ignored_folders(path: Path) -> None:
    """Print a note where a folder holds submissions for several tracks, of which the first is meant."""
    from vitac.envs.untrusted_file import find_spelling
    from vitac.evaluator.submission.names import MANIFEST_NAME
    from vitac.evaluator.tracks import archive_folders

    found = (
        []
        if find_spelling(path, MANIFEST_NAME).is_file()
        else [top for top in archive_folders() if find_spelling(path / top, MANIFEST_NAME).is_file()]
    )
    if len(found) > 1:
        print(
            f"vitac: takes {path / found[0]}; {' and '.join(found[1:])} beside it {'is' if len(found) == 2 else 'are'} "
            f"ignored: name that folder to take it",
            file=sys.stderr,
        )
