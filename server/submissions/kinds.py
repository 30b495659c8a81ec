"""What the service does with each kind of submission: how large it may be, and how it is checked and shown.

The one place of the uploads that distinguishes kinds; `evaluator.submission_kinds` says what holds of each anywhere.
"""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

from vitac.evaluator.agent.verdicts import EpisodeCut, PolicyFailed
from vitac.evaluator.logs.findings import LogFinding
from vitac.evaluator.remote.description import DIALS_IN, RemoteProtocol, RemoteServer
from vitac.evaluator.remote.line import AddressInvalid, inner_address
from vitac.evaluator.remote.session import BlankAnswer, test_connection
from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.sensors.package import design_document
from vitac.evaluator.submission.archive import unpack
from vitac.evaluator.submission.image import image_digest, largest_image_bytes, list_layers, unpack_image
from vitac.evaluator.submission.likeness import WEIGHTS_SUFFIXES, make_sketch
from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest, load_unpacked_manifest
from vitac.evaluator.submission.names import ArchiveRejected
from vitac.evaluator.submission.sources import submission_digest
from vitac.evaluator.submission.wheels import unpack_wheels
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Task, Track

from ..database.models import Evaluation, Submission
from ..database.states import FileRole
from ..errors import ProblemCode, ServiceError
from ..evaluations.logs import log_view
from ..services import Services
from ..settings import Settings
from ..storage import stored_files
from ..storage.blobs import cut
from ..tracks import load_known_track
from ..views.receipts import LogView
from ..views.submissions import ArchiveContents, BlankAnswerView
from .intake import CheckedUpload, ReceivedFile, UploadedFile
from .log_checks import check_log, check_text_log

FRAMEWORKS: Final = ("torch", "tensorflow", "jax", "onnxruntime", "sklearn", "scipy", "cv2", "numpy")
"""Modules whose import says with what a policy computes."""
_IMPORT: Final = re.compile(rb"^[ \t]*(?:from|import)[ \t]+([^\n#]+)", re.MULTILINE)
_CODE_BYTES: Final = 2**19
"""Size of a file of code up to which it is looked at."""


def read_contents(folder: Path) -> ArchiveContents:
    """Return what an unpacked archive holds."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
    code = [path for path in files if path.suffix == ".py"]
    imported = {name for path in code for name in _find_imports(path)}
    return ArchiveContents(
        frameworks=[name for name in FRAMEWORKS if name in imported],
        code_bytes=sum(path.stat().st_size for path in code),
        weights_bytes=sum(path.stat().st_size for path in files if path.suffix in WEIGHTS_SUFFIXES),
    )


def _find_imports(path: Path) -> set[str]:
    with path.open("rb") as file:
        lines = _IMPORT.findall(file.read(_CODE_BYTES))
    return {name for line in lines for name in re.findall(r"\w+", line.decode("utf-8", errors="replace"))}


_UNPACKED_NAME = "unpacked"
_DOCUMENT_NAME = "design-document"


@contextmanager
def _refusals_told() -> Iterator[None]:
    """Raise what a body or its manifest breaks as the service's error."""
    try:
        yield
    except ArchiveRejected as error:
        raise ServiceError(ProblemCode.ARCHIVE_REJECTED, error.message, reason=error.code.value) from error
    except ManifestRejected as error:
        raise ServiceError(ProblemCode.MANIFEST_REJECTED, str(error)) from error


def check_model(received: ReceivedFile, owner: str, settings: Settings) -> CheckedUpload:
    """Unpack an archive beside itself and read its manifest; nothing of it is imported.

    Args:
        received: the body.
        owner: the team whose submission it becomes, and whose policy may dial in.
        settings: limits on archives.

    Raises:
        ServiceError: the archive or its manifest breaks a rule.
    """
    with _refusals_told():
        folder = unpack(received.path, received.path.with_name(_UNPACKED_NAME), settings.limits)
        manifest, digest = load_unpacked_manifest(folder), submission_digest(folder, settings.limits)
        track = load_known_track(manifest.track)
        sketch, contents = make_sketch(folder), read_contents(folder)  # of the team's own files, without the wheels'
        unpack_wheels(folder, settings.limits)
    if manifest.remote is not None:
        tasks = [track.tasks[task] for task in manifest.tasks]
        answers = [
            BlankAnswerView.model_validate(asdict(answer))
            for answer in _ask_policy_server(manifest.remote, tasks, settings, owner)
        ]
        contents = contents.model_copy(update={"blank_answers": answers})
    return CheckedUpload(
        kind=SubmissionKind.MODEL if manifest.remote is None else SubmissionKind.REMOTE,
        track=manifest.track,
        tasks=track.list_played_tasks(manifest.tasks),
        name=manifest.name,
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=manifest.model_dump(mode="json"),
        archive_sketch=sketch.to_bytes(),
        contents=contents.model_dump(),
        files=(_take_document(folder),) if track.has_sensor else (),
    )


def check_image(received: ReceivedFile, owner: str, settings: Settings) -> CheckedUpload:  # noqa: ARG001 - as all checks
    """Unpack an image beside itself and read its manifest; nothing of it is run.

    Args:
        received: the body.
        owner: the team whose submission it becomes, which an image does not name.
        settings: limits on images.

    Raises:
        ServiceError: the image or its manifest breaks a rule.
    """
    with _refusals_told():
        folder = unpack_image(received.path, received.path.with_name(_UNPACKED_NAME), settings.limits)
        manifest, digest = load_manifest(folder), image_digest(received.path, settings.limits)
    track = load_known_track(manifest.track)
    if track.has_sensor:
        raise ServiceError(ProblemCode.UNSUPPORTED_SUBMISSION_KIND, f"{track.name} takes sensors, not images.")
    return CheckedUpload(
        kind=SubmissionKind.IMAGE,
        track=manifest.track,
        tasks=track.list_played_tasks(manifest.tasks),
        name=manifest.name,
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=manifest.model_dump(mode="json"),
        pieces=cut(received.path, list_layers(received.path, settings.limits)),
    )


def require_allowed(server: RemoteServer, settings: Settings, team: str) -> str:
    """Return the address at which the service may ask a team's policy server.

    Raises:
        ServiceError: it has none, or another one.
    """
    if server.protocol is RemoteProtocol.LEROBOT:
        raise ServiceError(
            ProblemCode.MANIFEST_REJECTED,
            "submission.yaml has a policy server speak lerobot, whose messages are pickles, and a service reads none. "
            "`vitac remote connect FOLDER --remote grpc://HOST:PORT` asks it on your machine.",
        )
    if server.address == DIALS_IN:
        if not settings.remote_gate:
            raise ServiceError(
                ProblemCode.MANIFEST_REJECTED,
                "submission.yaml has a policy server dial in (`address: connect`), but this service has no gate. Play "
                "with `vitac evaluate --remote ADDRESS --log run.jsonl` and submit the log, or ask the organizers.",
            )
        return inner_address(settings.remote_gate, team)
    if server.address is None or server.address not in settings.allowed_remote_addresses:
        raise ServiceError(
            ProblemCode.MANIFEST_REJECTED,
            f"submission.yaml has the policy server {server.address or 'without an address'} play (`remote`); this "
            f"service asks {', '.join(settings.allowed_remote_addresses) or 'none'}. Play with "
            "`vitac evaluate --remote ADDRESS --log run.jsonl` and submit the log, or ask the organizers.",
        )
    return server.address


def _ask_policy_server(
    server: RemoteServer, tasks: Sequence[Task], settings: Settings, team: str
) -> tuple[BlankAnswer, ...]:
    """Return the answers of a policy server to a blank observation of each task; one that gives none is refused.

    Raises:
        ServiceError: it is not allowed, or its answer would fail an episode.
    """
    address = require_allowed(server, settings, team)
    limits = replace(settings.limits, start_wall_s=CONNECTION_TEST_S)
    try:
        return test_connection(address, server, tasks, limits)
    except (AddressInvalid, PolicyFailed, EpisodeCut) as error:
        reason = f"{error.message} {error.verdict.sentence}" if isinstance(error, PolicyFailed) else str(error)
        raise ServiceError(
            ProblemCode.MANIFEST_REJECTED, f"The policy server failed the test with a blank observation. {reason}"
        ) from error


def _take_document(folder: Path) -> UploadedFile:
    """Return the design document of an unpacked submission.

    Raises:
        ServiceError: there is none, or several.
    """
    try:
        document = design_document(folder)
    except SensorRejected as error:
        raise ServiceError(ProblemCode.SENSOR_REJECTED, str(error)) from error
    with document.path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return UploadedFile(
        role=FileRole.DOCUMENT,
        path=document.path,
        sha256=sha256,
        n_bytes=document.n_bytes,
        name=f"{_DOCUMENT_NAME}{document.suffix}",
    )


ShowLog = Callable[[Submission, Evaluation, LogFinding | None], LogView]


@dataclass(frozen=True, kw_only=True)
class ServedKind:
    """A kind of submission as the service takes it."""

    max_bytes: Callable[[Settings], int]  #: largest body
    check: Callable[[ReceivedFile, str, Settings], CheckedUpload]  #: all rules, given the owner's name
    names_track: tuple[ProblemCode, str]  #: refusal of a body for another track, and where the body names it
    log_view: ShowLog | None = None  #: shows what a log claims and what was found about it


CONNECTION_TEST_S = 10.0
"""Time that a policy server has to greet, and again for its first answer, before anything is queued."""

_MODEL: Final = ServedKind(
    max_bytes=lambda settings: settings.limits.archive_packed_bytes,
    check=check_model,
    names_track=(ProblemCode.MANIFEST_REJECTED, "submission.yaml says track"),
)
_LOG: Final = ServedKind(
    max_bytes=lambda settings: settings.log_bytes,
    check=check_log,
    names_track=(ProblemCode.LOG_REJECTED, "the log is of"),
    log_view=log_view,
)
SERVED_KINDS: Mapping[SubmissionKind, ServedKind] = MappingProxyType(
    {
        SubmissionKind.MODEL: _MODEL,
        SubmissionKind.IMAGE: replace(
            _MODEL, max_bytes=lambda settings: largest_image_bytes(settings.limits), check=check_image
        ),
        SubmissionKind.REMOTE: _MODEL,
        SubmissionKind.LOG: _LOG,
        SubmissionKind.TEXT_LOG: replace(_LOG, check=check_text_log),
    }
)


def check_kind(kind: SubmissionKind, track: Track) -> None:
    """Refuse what a track does not take.

    Raises:
        ServiceError: with the kinds that it takes.
    """
    if kind not in track.accepts:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"{track.name} takes {', '.join(track.accepts)}, got {kind}.",
            supported=list(track.accepts),
        )


def accept(
    services: Services, received: ReceivedFile, *, kind: SubmissionKind, track: str | None, owner: str
) -> CheckedUpload:
    """Check a body and store it.

    Args:
        services: of this process.
        received: the body.
        kind: what it must be.
        track: what the request named; the body must name the same.
        owner: the team whose submission it becomes; a log must name no other.

    Raises:
        ServiceError: a rule is broken, or the file store is unavailable.
    """
    upload = SERVED_KINDS[kind].check(received, owner, services.settings)
    if track is not None and upload.track != track:
        raise _other_track(upload, track)
    check_kind(kind, load_known_track(upload.track))
    paths = {received.sha256: received.path} | {file.sha256: file.path for file in upload.files}
    for digest, path in paths.items():
        with services.database.transaction() as session:
            pieces = upload.pieces if digest == received.sha256 else ()
            stored_files.store(session, services.blobs, path, digest, pieces)
    return upload


@contextmanager
def removed_if_refused(services: Services, upload: CheckedUpload) -> Iterator[None]:
    """Remove what was stored of an upload that the block refuses: those refused again and again would fill the disk."""
    try:
        yield
    except ServiceError:
        remove_unnamed(services, upload)
        raise


def remove_unnamed(services: Services, upload: CheckedUpload) -> None:
    """Remove what was stored of an upload and no submission names; what cannot be removed now, housekeeping removes."""
    with suppress(ServiceError):
        stored_files.remove_unnamed(services.database, services.blobs, upload.digests)


def _other_track(upload: CheckedUpload, track: str) -> ServiceError:
    code, says = SERVED_KINDS[upload.kind].names_track
    return ServiceError(code, f"The request is for {track!r}, but {says} {upload.track!r}. Make them agree.")
