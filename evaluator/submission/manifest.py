"""The submission manifest, submission.yaml: its keys, and whether they fit the track that it names."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Final

from pydantic import AfterValidator, Field
from vitac.envs.untrusted_file import find_spelling
from vitac.errors import VitacError

from ..agent.verdicts import VerdictCode
from ..remote.description import RemoteServer
from ..strict_model import DocumentRejected, StrictModel, parse_untrusted_yaml
from ..submission_kinds import Need
from ..tracks import UnknownTrack, load_track
from .names import MANIFEST_NAME, ArchiveFault, ArchiveRejected, listed

MANIFEST_MAX_BYTES: Final = 16 * 1024
_TASKS_MAX: Final = 128
"""More than any track has; whether the named ones exist is asked of the track."""
_ENTRY_POINT: Final = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")


class ManifestRejected(VitacError):
    """submission.yaml is missing or wrong: correct the key that the message names."""

    verdict = VerdictCode.MANIFEST_REJECTED


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
    remote: Annotated[
        RemoteServer | None,
        Field(description="Policy server that plays in place of the folder's own code."),
    ] = None

    needs: Annotated[
        Need | None,
        Field(description="gpu: an image that plays on workers with an NVIDIA GPU only."),
    ] = None

    @property
    def read_keys(self) -> tuple[str, ...] | None:
        """Keys of the observation that the policy reads; None for all."""
        if self.remote is not None and self.remote.keys is not None:
            return self.remote.keys
        return self.observation_keys

    def own_entry_point(self) -> str:
        """Return module:Class of the policy that the folder brings.

        Raises:
            ManifestRejected: a policy server plays in its place, or it needs what only images get.
        """
        self.require_no_needs()
        if self.remote is not None:
            raise ManifestRejected(
                f"{MANIFEST_NAME} has a policy server play (`remote`), expected a policy of the folder's own: play "
                "with `vitac evaluate --remote ADDRESS`."
            )
        return self.entry_point

    def require_no_needs(self) -> None:
        """Refuse a folder that needs what only images get.

        Raises:
            ManifestRejected: it does.
        """
        if self.needs is not None:
            raise ManifestRejected(
                f"{MANIFEST_NAME} says `needs: {self.needs}`, which only container images get: leave it out, or "
                "submit an image (docs/images.md)."
            )

    def server(self) -> RemoteServer:
        """Return the section `remote`.

        Raises:
            ManifestRejected: there is none.
        """
        if self.remote is None:
            raise ManifestRejected(
                f"{MANIFEST_NAME} has no section `remote`, which says what the policy server speaks: add "
                "`remote: {protocol: openpi}`, say."
            )
        return self.remote


def load_manifest(submission_dir: Path) -> SubmissionManifest:
    """Return the manifest of an unpacked submission, checked against the tracks there are.

    Raises:
        ManifestRejected: it is missing, no file, too large, not YAML, or a key or value is wrong.
    """
    path = find_spelling(submission_dir, MANIFEST_NAME)
    try:
        with path.open("rb") as file:
            data = file.read(MANIFEST_MAX_BYTES + 1)
    except FileNotFoundError as error:
        names = [path.name for path in submission_dir.glob("*")]
        mend = renaming(names) or "put it directly into that folder"
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
    check_top_folder(manifest, submission_dir.name)
    manifest.require_no_needs()
    return manifest


def parse_manifest(data: bytes) -> SubmissionManifest:
    """Return the manifest that the bytes of submission.yaml hold.

    Raises:
        ManifestRejected: too large, not YAML, or a key or value is wrong.
    """
    if len(data) > MANIFEST_MAX_BYTES:
        raise ManifestRejected(f"{MANIFEST_NAME} is larger than {MANIFEST_MAX_BYTES} bytes; make it smaller.")
    try:
        manifest = parse_untrusted_yaml(SubmissionManifest, data.decode("utf-8"), MANIFEST_NAME)
    except UnicodeDecodeError as error:
        raise ManifestRejected(f"{MANIFEST_NAME} is not UTF-8 ({error}); save it as UTF-8.") from error
    except DocumentRejected as error:
        raise ManifestRejected(str(error)) from error
    _check_tasks(manifest)
    _check_observation_keys(manifest)
    _check_remote(manifest)
    _check_control_modes(manifest)
    return manifest


def renaming(names: Iterable[str]) -> str:
    """Return which file should have the manifest's name, such as submission.yml; nothing where none is like it."""
    others = [name for name in names if name != MANIFEST_NAME]
    close = get_close_matches(MANIFEST_NAME, others, n=1, cutoff=0.8)
    return f"rename {close[0]!r} to {MANIFEST_NAME}" if close else ""


def check_top_folder(manifest: SubmissionManifest, top: str) -> None:
    """Refuse an archive whose top folder is that of another track.

    Raises:
        ArchiveRejected: it is.
    """
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
    named = manifest.read_keys or ()
    place = "remote.observations" if manifest.remote else "observation_keys"
    unknown = sorted(set(named) - set(known))
    if unknown or len(set(named)) != len(named):
        got = f"{unknown[0]!r}" if unknown else "a key twice"
        raise ManifestRejected(f"{MANIFEST_NAME}: {place} has {got}, expected each once, out of {', '.join(known)}.")


def _check_remote(manifest: SubmissionManifest) -> None:
    if manifest.remote is None:
        return
    ignored = {"entry_point", "observation_keys"} & manifest.model_fields_set
    if ignored:
        raise ManifestRejected(
            f"{MANIFEST_NAME}: {' and '.join(sorted(ignored))} is of a policy of the folder's own, and a policy server "
            "plays (`remote`). Leave it out; remote.observations names what is sent."
        )
    tasks = load_track(manifest.track).tasks
    rows = {row.name: row for task in manifest.tasks for row in tasks[task].observables}
    for name, value in (manifest.remote.observations or {}).items():
        if value.size is not None and len(rows[value.key].shape) not in {2, 3}:
            raise ManifestRejected(
                f"{MANIFEST_NAME}: remote.observations.{name} has a size, but {value.key} is no picture; leave it out."
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
