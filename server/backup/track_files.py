"""Track files of the organizers' own, which a service needs beside its database: read for a backup, put back by it."""

import os
from collections.abc import Mapping
from pathlib import Path

from pydantic import TypeAdapter
from vitac.evaluator.strict_model import DocumentRejected, Word
from vitac.evaluator.tracks.registry import TRACKS_FOLDER_VARIABLE

from .archive import BackupRejected

_NAME = TypeAdapter[str](Word)


def own_track_files() -> dict[str, str]:
    """Return the content of each file in the folder that VITAC_TRACKS_DIR names, by its name without `.yaml`.

    Raises:
        DocumentRejected: one has a name that no track may have, is not text, or cannot be read.
    """
    folder = os.environ.get(TRACKS_FOLDER_VARIABLE)
    if not folder:
        return {}
    return dict(map(_read, sorted(Path(folder).glob("*.yaml"))))


def _read(path: Path) -> tuple[str, str]:
    try:
        # As bytes: the evaluator's version counts those, and reading text would change the ends of lines.
        return _NAME.validate_python(path.stem), path.read_bytes().decode("utf-8")
    except OSError as error:
        raise DocumentRejected(f"{str(path)!r} cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise DocumentRejected(
            f"{str(path)!r} is no track file: expected text in UTF-8, and a name of at most 100 letters, digits and "
            "any of . _ + : - without spaces. Rename, correct or remove it."
        ) from error


def missing_track_files(files: Mapping[str, str] | None) -> Mapping[Path, str]:
    """Return where those of a backup belong that are not there yet, with their content.

    Args:
        files: of the backup; None where it is of a release that did not keep them: the folder is taken as it is.

    Raises:
        BackupRejected: no folder is named for them, another file has the place of one, or there are further ones.
        DocumentRejected: as `own_track_files`.
    """
    if files is None:
        return {}
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
    if further := ", ".join(f"{name}.yaml" for name in sorted(present.keys() - files.keys())):
        raise BackupRejected(
            f"Expected only track files of the backup in {folder}, got {further} too: with them all results would be "
            "of another evaluator version. Move them away for the restore."
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
            draft = path.with_name("unfinished")  # killed here, the file is missing still
            draft.write_bytes(content.encode("utf-8"))
            draft.replace(path)
    except OSError as error:
        raise BackupRejected(f"{error.filename} cannot be written: {error.strerror}.") from error
