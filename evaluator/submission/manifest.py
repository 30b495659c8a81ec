"""A submission as a zip or folder: its submission manifest (submission.yaml) and its digest."""

import hashlib
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import IO, Annotated, Final

from pydantic import AfterValidator, Field
from vitac.envs.errors import VitacError

from ..agent.limits import Limits
from ..agent.verdicts import VerdictCode
from ..strict_model import DocumentRejected, StrictModel, parse_untrusted_yaml
from ..tracks import UnknownTrack, archive_folders, load_track
from .archive import ArchiveFault, ArchiveRejected, Entry, packed_entries, unpack, write
from .names import MANIFEST_NAME, NamedEntry, check_names, contents_of, is_ignored, link, listed, special_file

_MANIFEST_MAX_BYTES: Final = 16 * 1024
_TASKS_MAX: Final = 128
"""More than any track has; whether the named ones exist is asked of the track."""
_ENTRY_POINT: Final = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


class ManifestRejected(VitacError):
    """submission.yaml is missing or wrong: correct the key that the message names."""

    verdict = VerdictCode.MANIFEST_REJECTED


class NoSubmission(VitacError):
    """The path is neither a zip nor a folder of a submission: name one."""


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of printable characters")
    return text


def _entry_point(text: str) -> str:
    if _ENTRY_POINT.fullmatch(text):
        return text
    module, _, name = text.rpartition(".")
    nearest = f"{module}:{name}"
    hint = f"; did you mean {nearest!r}?" if _ENTRY_POINT.fullmatch(nearest) else ""
    raise ValueError(
        f"expected a module, a colon and a class, such as 'policy:Policy' for class Policy in policy.py{hint}"
    )


Name = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(_printable)]


class SubmissionManifest(StrictModel):
    """submission.yaml."""

    track: Annotated[Name, Field(description="Track that it enters, such as track_1.")]
    tasks: Annotated[
        tuple[Name, ...],
        Field(min_length=1, max_length=_TASKS_MAX, description="Tasks that it plays, such as peg-insertion."),
    ]
    name: Annotated[Name, Field(description="Shown on the leaderboard.")]
    entry_point: Annotated[
        str, Field(max_length=200, description="module:Class of the policy."), AfterValidator(_entry_point)
    ] = "policy:Policy"
    observation_keys: Annotated[
        tuple[Name, ...] | None,
        Field(max_length=64, description="Keys of the observation that it reads; all by default. Others are not sent."),
    ] = None
    control_modes: Annotated[
        dict[Name, Name],
        Field(
            default_factory=dict,
            max_length=_TASKS_MAX,
            description="Control mode that its actions are made for, by task; refused where the task has another one.",
        ),
    ]


def load_manifest(submission_dir: Path) -> SubmissionManifest:
    """Return the manifest of an unpacked submission, checked against the tracks there are.

    Raises:
        ManifestRejected: it is missing, no file, too large, not YAML, or a key or value is wrong.
    """
    path = submission_dir / MANIFEST_NAME
    try:
        with path.open("rb") as file:
            data = file.read(_MANIFEST_MAX_BYTES + 1)
    except FileNotFoundError as error:
        names = [path.name for path in submission_dir.glob("*")]
        mend = _renaming(names) or "put it directly into that folder"
        raise ManifestRejected(
            f"{MANIFEST_NAME} is missing, the submission's folder holds {listed(names)}; {mend}."
        ) from error
    except IsADirectoryError as error:
        raise ManifestRejected(f"{MANIFEST_NAME} is a folder, expected a file.") from error
    except NotADirectoryError as error:
        raise ManifestRejected(f"{submission_dir.name} is a file, expected a folder with {MANIFEST_NAME}.") from error
    return parse_manifest(data)


def load_unpacked_manifest(submission_dir: Path) -> SubmissionManifest:
    """Return the manifest of an unpacked archive, whose top folder must be that of its track.

    Args:
        submission_dir: what `archive.unpack` returned.

    Raises:
        ManifestRejected: it is missing or wrong.
        ArchiveRejected: the folder is that of another track.
    """
    manifest = load_manifest(submission_dir)
    _check_top_folder(manifest, submission_dir.name)
    return manifest


def parse_manifest(data: bytes) -> SubmissionManifest:
    """Return the manifest that the bytes of submission.yaml hold.

    Raises:
        ManifestRejected: too large, not YAML, or a key or value is wrong.
    """
    if len(data) > _MANIFEST_MAX_BYTES:
        raise ManifestRejected(f"{MANIFEST_NAME} is larger than {_MANIFEST_MAX_BYTES} bytes; make it smaller.")
    try:
        manifest = parse_untrusted_yaml(SubmissionManifest, data.decode("utf-8"), MANIFEST_NAME)
    except UnicodeDecodeError as error:
        raise ManifestRejected(f"{MANIFEST_NAME} is not UTF-8 ({error}); save it as UTF-8.") from error
    except DocumentRejected as error:
        raise ManifestRejected(str(error)) from error
    _check_tasks(manifest)
    _check_observation_keys(manifest)
    _check_control_modes(manifest)
    return manifest


def find_submission(path: Path) -> Path:
    """Return the folder below a path that holds submission.yaml: itself, or its folder of a track, such as `Track_1`.

    Raises:
        NoSubmission: there is none.
    """
    if not path.exists():
        raise NoSubmission(f"{path} does not exist; {contents_of(path.parent)}.")
    for folder in (path, *(path / top for top in archive_folders())):
        if (folder / MANIFEST_NAME).is_file():
            return folder
    mend = _renaming(each.name for each in path.glob("*")) or "name the submission's folder or its zip"
    raise NoSubmission(f"Expected {MANIFEST_NAME} or a zip, {contents_of(path)}; {mend}.")


def _renaming(names: Iterable[str]) -> str:
    """Return which file should have the manifest's name, such as submission.yml; nothing where none is like it."""
    others = [name for name in names if name != MANIFEST_NAME]
    close = get_close_matches(MANIFEST_NAME, others, n=1, cutoff=0.8)
    return f"rename {close[0]!r} to {MANIFEST_NAME}" if close else ""


def manifest_of(source: Path, limits: Limits | None = None) -> SubmissionManifest:
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
            if entry.path == MANIFEST_NAME and entry.n_bytes <= _MANIFEST_MAX_BYTES:
                manifest = parse_manifest(b"".join(entry.chunks()))
                _check_top_folder(manifest, top)
                return manifest
    names = [entry.path for entry in entries]
    mend = _renaming(names) or "put it directly into the submission's folder"
    raise ManifestRejected(
        f"{MANIFEST_NAME} is missing or larger than {_MANIFEST_MAX_BYTES} bytes; {mend}. "
        f"The archive holds {listed(names)}."
    )


def top_folder(submission_dir: Path) -> str:
    """Return the one folder that an archive of a submission holds: its track's.

    Raises:
        ManifestRejected: the manifest cannot be read.
    """
    return load_track(load_manifest(submission_dir).track).folder


def stage(source: Path, destination: Path, limits: Limits | None = None) -> Path:
    """Copy a zip or folder to where it can be evaluated, under the same rules for both.

    Args:
        source: zip, submission folder, or the folder that contains it under its track's name, such as `Track_1`.
        destination: new or empty folder.
        limits: sizes and counts.

    Returns:
        The submission's folder below `destination`, readable by every user.

    Raises:
        ArchiveRejected: a rule of archives is broken, or the top folder of a zip is that of another track.
        ManifestRejected: the manifest is missing or wrong.
        NoSubmission: the path is not a submission.
    """
    limits = limits or Limits()
    if source.is_file():
        manifest_of(source, limits)  # refuses the folder of another track
        return unpack(source, destination, limits)
    found = find_submission(source)
    top = top_folder(found)
    return write(_folder_entries(found, top, limits), destination, top, limits)


def submission_digest(source: Path, limits: Limits | None = None) -> str:
    """Return SHA-256 over path, size and content of every file, sorted by path: equal for a folder and its zip.

    Raises:
        ArchiveRejected: a rule of archives is broken.
        ManifestRejected: the manifest of a folder is missing or wrong.
        NoSubmission: the path is not a submission.
    """
    limits = limits or Limits()
    with ExitStack() as exits:
        if source.is_file():
            _, entries = packed_entries(exits.enter_context(source.open("rb")), limits, exits)
        else:
            found = find_submission(source)
            entries = _folder_entries(found, top_folder(found), limits)
        return _digest(entries)


def _digest(entries: list[Entry]) -> str:
    digest = hashlib.sha256()
    for entry in sorted(entries, key=lambda entry: entry.path):
        path = entry.path.encode()
        digest.update(len(path).to_bytes(8, "little") + path + entry.n_bytes.to_bytes(8, "little"))
        for chunk in entry.chunks():
            digest.update(chunk)
    return digest.hexdigest()


def _folder_entries(folder: Path, top: str, limits: Limits) -> list[Entry]:
    entries = list(_walk(folder, ""))
    check_names((NamedEntry(path=f"{top}/{entry.path}", is_folder=False) for entry in entries), limits)
    return entries


def _walk(folder: Path, prefix: str) -> Iterator[Entry]:
    for item in sorted(os.scandir(folder), key=lambda item: item.name):
        path = f"{prefix}{item.name}"
        if is_ignored(path):
            continue
        if item.is_symlink():
            raise link(path)
        if item.is_dir():
            yield from _walk(Path(item.path), f"{path}/")
        elif item.is_file():
            yield Entry(path=path, n_bytes=item.stat().st_size, open=partial(_open, item.path))
        else:
            raise special_file(path)


def _open(path: str) -> IO[bytes]:
    return Path(path).open("rb")


def _check_top_folder(manifest: SubmissionManifest, top: str) -> None:
    expected = load_track(manifest.track).folder
    if top != expected:
        raise ArchiveRejected(
            ArchiveFault.WRONG_TOP_FOLDER,
            f"{MANIFEST_NAME} names {manifest.track}: expected folder {expected}, got {top}; rename the folder and "
            "pack it again.",
        )


def _check_tasks(manifest: SubmissionManifest) -> None:
    try:
        track = load_track(manifest.track)
    except UnknownTrack as error:
        raise ManifestRejected(f"{MANIFEST_NAME}: {error}") from error
    unknown = sorted(set(manifest.tasks) - set(track.tasks))
    if unknown or len(set(manifest.tasks)) != len(manifest.tasks):
        raise ManifestRejected(
            f"{MANIFEST_NAME}: tasks are {', '.join(manifest.tasks)}, expected each once, "
            f"out of {', '.join(track.tasks)}."
        )


def _check_observation_keys(manifest: SubmissionManifest) -> None:
    tasks = load_track(manifest.track).tasks
    known = list(dict.fromkeys(row.name for task in manifest.tasks for row in tasks[task].observables))
    named = manifest.observation_keys or ()
    unknown = sorted(set(named) - set(known))
    if unknown or len(set(named)) != len(named):
        got = f"{unknown[0]!r}" if unknown else "a key twice"
        raise ManifestRejected(
            f"{MANIFEST_NAME}: observation_keys has {got}, expected each once, out of {', '.join(known)}."
        )


def _check_control_modes(manifest: SubmissionManifest) -> None:
    track = load_track(manifest.track)
    for name, mode in manifest.control_modes.items():
        if name not in manifest.tasks:
            its_own = ", ".join(manifest.tasks)
            raise ManifestRejected(
                f"{MANIFEST_NAME}: control_modes names {name!r}, expected one of its tasks: {its_own}."
            )
        expected = track.tasks[name].definition.control_mode
        if mode != expected:
            what = f"expected {expected!r}, which the track sets" if expected else "which has no control modes"
            raise ManifestRejected(f"{MANIFEST_NAME}: control_modes has {mode!r} for {name}, {what}.")
