"""Track files of the organizers' own, which a service needs beside its database: read for a backup, put back by it."""

import os
from collections.abc import Mapping
from pathlib import Path

from vitac.evaluator.version import TRACKS_FOLDER_VARIABLE

from .archive import BackupRejected


def own_track_files() -> dict[str, str]:
    """Return the content of each file in the folder that VITAC_TRACKS_DIR names, by its name without `.yaml`."""
    folder = os.environ.get(TRACKS_FOLDER_VARIABLE)
    if not folder:
        return {}
    # As bytes: the evaluator's version counts those, and reading text would change the ends of lines.
    return {path.stem: path.read_bytes().decode("utf-8") for path in sorted(Path(folder).glob("*.yaml"))}


def missing_track_files(files: Mapping[str, str]) -> Mapping[Path, str]:
    """Return where those of a backup belong that are not there yet, with their content.

    Raises:
        BackupRejected: no folder is named for them, or another file has the place of one.
    """
    folder = os.environ.get(TRACKS_FOLDER_VARIABLE)
    if files and not folder:
        raise BackupRejected(
            f"The backup has track files of its own ({', '.join(files)}), expected a folder for them; name one in "
            f"{TRACKS_FOLDER_VARIABLE}, the same for server and workers."
        )
    present = own_track_files()
    for name in files.keys() & present.keys():
        if files[name] != present[name]:
            raise BackupRejected(
                f"The track file {name}.yaml in {folder} is another one than the backup's; name another folder in "
                f"{TRACKS_FOLDER_VARIABLE}."
            )
    return {Path(folder or "") / f"{name}.yaml": files[name] for name in files.keys() - present.keys()}


def put_back(files: Mapping[Path, str]) -> None:
    """Write the files of a backup that are missing.

    Raises:
        BackupRejected: the folder cannot be written.
    """
    try:
        for path, content in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            draft = path.with_suffix(".unfinished")  # killed here, the file is missing still
            draft.write_bytes(content.encode("utf-8"))
            draft.replace(path)
    except OSError as error:
        raise BackupRejected(f"{error.filename} cannot be written: {error.strerror}.") from error
