"""What a submission is read from, a zip or a folder: its manifest, its digest, and a copy that can be evaluated."""

import hashlib
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from vitac.envs.untrusted_file import find_spelling
from vitac.errors import VitacError

from ..agent.limits import Limits
from ..submission_kinds import SubmissionKind
from ..tracks import archive_folders, load_track
from .archive import ArchiveEntry, packed_entries, unpack, write
from .image import image_digest, unpack_image
from .manifest import (
    MANIFEST_MAX_BYTES,
    ManifestRejected,
    SubmissionManifest,
    check_top_folder,
    load_manifest,
    parse_manifest,
    renaming,
)
from .names import (
    MANIFEST_NAME,
    NamedEntry,
    check_names,
    describe_contents,
    fixed_name,
    is_ignored,
    link,
    listed,
    special_file,
)
from .wheels import unpack_wheels


class NoSubmission(VitacError):
    """The path is neither a zip nor a folder of a submission: name one."""


def find_submission(path: Path) -> Path:
    """Return the folder below a path that holds submission.yaml: itself, or its folder of a track, such as `Track_1`.

    Raises:
        NoSubmission: there is none.
    """
    if not path.exists():
        raise NoSubmission(f"{path} does not exist; {describe_contents(path.parent)}.")
    for folder in (path, *(path / top for top in archive_folders())):
        if find_spelling(folder, MANIFEST_NAME).is_file():
            return folder
    mend = renaming(each.name for each in path.glob("*")) or _unknown_track(path)
    raise NoSubmission(f"Expected {MANIFEST_NAME} or a zip, {describe_contents(path)}; {mend}.")


def _unknown_track(path: Path) -> str:
    """Return what to do about a folder without a submission: often its track's file is missing on this machine."""
    inside = [each.parent.name for each in path.glob(f"*/{MANIFEST_NAME}")]
    if len(inside) != 1:
        return "name the submission's folder or its zip"
    return (
        f"folder {inside[0]!r} holds one, but no track of this machine has a folder of that name, only "
        f"{', '.join(archive_folders())}: rename it, or set VITAC_TRACKS_DIR to the folder with its track's file"
    )


def read_manifest_file(source: Path, limits: Limits | None = None) -> SubmissionManifest:
    """Read the manifest of a zip or a folder; nothing is unpacked.

    Raises:
        ManifestRejected: it is missing or cannot be read.
        ArchiveRejected: a rule of archives is broken, or the top folder of a zip is that of another track.
        NoSubmission: the path is no submission.
    """
    if not source.is_file():
        return load_manifest(find_submission(source))
    with ExitStack() as exits:
        top, entries = packed_entries(exits.enter_context(source.open("rb")), limits or Limits(), exits)
        for entry in entries:
            if entry.path == MANIFEST_NAME and entry.n_bytes <= MANIFEST_MAX_BYTES:
                manifest = parse_manifest(b"".join(entry.chunks()))
                check_top_folder(manifest, top)
                return manifest
    names = [entry.path for entry in entries]
    mend = renaming(names) or "put it directly into the submission's folder"
    raise ManifestRejected(
        f"{MANIFEST_NAME} is missing or larger than {MANIFEST_MAX_BYTES} bytes; {mend}. "
        f"The archive holds {listed(names)}."
    )


def stage(
    source: Path, destination: Path, limits: Limits | None = None, kind: SubmissionKind = SubmissionKind.MODEL
) -> Path:
    """Copy a submission to where it can be evaluated: a zip and a folder under the same rules, with wheels unpacked.

    Args:
        source: zip, submission folder, or the folder that contains it under its track's name, such as `Track_1`; of an
            image its tar.
        destination: new or empty folder.
        limits: sizes and counts.
        kind: what it is.

    Returns:
        The submission's folder below `destination`, readable by every user.

    Raises:
        ArchiveRejected: a rule of archives is broken, or the top folder of a zip is that of another track.
        ManifestRejected: the manifest is missing or wrong.
        NoSubmission: the path is not a submission.
    """
    limits = limits or Limits()
    if kind.form.is_image:
        return unpack_image(_existing_tar(source), destination, limits)
    if source.is_file():
        read_manifest_file(source, limits)  # refuses the folder of another track
        folder = unpack(source, destination, limits)
    else:
        submission = find_submission(source)
        top = top_folder(submission)
        folder = write(_folder_entries(submission, top, limits), destination, top, limits)
    unpack_wheels(folder, limits)
    return folder


def _existing_tar(source: Path) -> Path:
    if not source.is_file():
        raise NoSubmission(f"Expected the tar of a container image, got {source}; write one with `docker save`.")
    return source


@contextmanager
def staged(submission: Path, kind: SubmissionKind = SubmissionKind.MODEL) -> Iterator[Path]:
    """Return the folder of an unpacked copy of a submission, which is removed when the block is left.

    Args:
        submission: zip or folder, or the tar of an image.
        kind: what it is.

    Raises:
        ArchiveRejected: a rule of archives is broken.
        NoSubmission: the path is no submission.
    """
    with TemporaryDirectory(prefix="vitac-submission-") as folder:
        Path(folder).chmod(0o755)  # Under root the sandbox has a user of its own, which must reach the submission.
        yield stage(submission, Path(folder) / "submission", kind=kind)


def submission_digest(source: Path, limits: Limits | None = None, kind: SubmissionKind = SubmissionKind.MODEL) -> str:
    """Return SHA-256 over path, size and content of every file, sorted by path: equal for a folder and its zip.

    Of an image it is its id, equal however its layers are packed.

    Raises:
        ArchiveRejected: a rule of archives is broken.
        ManifestRejected: the manifest of a folder is missing or wrong.
        NoSubmission: the path is not a submission.
    """
    limits = limits or Limits()
    if kind.form.is_image:
        return image_digest(source, limits)
    with ExitStack() as exits:
        if source.is_file():
            _, entries = packed_entries(exits.enter_context(source.open("rb")), limits, exits)
        else:
            submission = find_submission(source)
            entries = _folder_entries(submission, top_folder(submission), limits)
        return _digest(entries)


def top_folder(submission_dir: Path) -> str:
    """Return the one folder that an archive of a submission holds: its track's.

    Raises:
        ManifestRejected: the manifest cannot be read.
    """
    return load_track(load_manifest(submission_dir).track).folder


def _folder_entries(folder: Path, top: str, limits: Limits) -> list[ArchiveEntry]:
    entries = [
        ArchiveEntry(path=fixed_name(path), n_bytes=(folder / path).stat().st_size, open=partial(_open, folder / path))
        for path in list_files(folder)
    ]
    check_names((NamedEntry(path=f"{top}/{entry.path}", is_folder=False) for entry in entries), limits)
    return entries


def list_files(folder: Path, prefix: str = "") -> Iterator[str]:
    """Yield the files of a submission's folder, in order, with `prefix` before their paths.

    Raises:
        ArchiveRejected: there is a link, or what is neither file nor folder.
    """
    for item in sorted(os.scandir(folder), key=lambda item: item.name):
        path = f"{prefix}{item.name}"
        if is_ignored(path):
            continue
        if item.is_symlink():
            raise link(path)
        if item.is_dir():
            yield from list_files(Path(item.path), f"{path}/")
        elif item.is_file():
            yield path
        else:
            raise special_file(path)


def _open(path: Path) -> IO[bytes]:
    return path.open("rb")


def _digest(entries: list[ArchiveEntry]) -> str:
    digest = hashlib.sha256()
    for entry in sorted(entries, key=lambda entry: entry.path):
        path = entry.path.encode()
        digest.update(len(path).to_bytes(8, "little") + path + entry.n_bytes.to_bytes(8, "little"))
        for chunk in entry.chunks():
            digest.update(chunk)
    return digest.hexdigest()
