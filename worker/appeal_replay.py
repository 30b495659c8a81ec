"""Plays an episode of an appeal again on this machine, with the submission's policy or a corrected one.

Called by `vitac admin appeal replay`. Nothing of the queue, the stored records or the boards is touched.
"""

import hashlib
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.evaluation.local import evaluate
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.sealed import write_secret
from vitac.server.appeals import appeals
from vitac.server.competitions.sealing import find_secret, played_track
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import Principal
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.server.storage.scratch import scratch_folder


@dataclass(frozen=True, kw_only=True)
class Replay:
    """An episode that was played again.

    Attributes:
        record: what it gave.
        policy_sha256: of the archive that was played.
        corrected: whether that is another one than the submission's.
    """

    record: EpisodeRecord
    policy_sha256: str
    corrected: bool


def replay(
    services: Services, by: Principal, appeal_id: int, *, task: str, episode: int, corrected: Path | None
) -> Replay:
    """Play one episode as `vitac evaluate` does.

    Args:
        services: open ones.
        by: an organizer.
        appeal_id: for which appeal.
        task: of the submission.
        episode: number in the list that the evaluation played.
        corrected: zip with another policy; None: the submission's.

    Raises:
        ServiceError: not an organizer, there is no such appeal or episode, it is about a log or a sensor, or the
            corrected policy does not play the task.
    """
    by.require_organizer()
    with services.database.transaction() as session:
        evaluation = appeals.find(session, by, appeal_id).evaluation
        appeals.require_episode(session, evaluation, task, episode)
        submission = evaluation.submission
        _require_policy(submission)
        track = played_track(session, submission.track, evaluation.commitment)
        secret = None if evaluation.commitment is None else find_secret(session, evaluation.commitment)
    with ExitStack() as stack:
        folder = stack.enter_context(scratch_folder(services.settings.scratch_dir, "replay"))
        archive = corrected or _fetched(services.blobs, submission, folder)
        secret_file = folder / "secret"
        if secret is not None:
            write_secret(secret_file, secret)
        unpacked = stack.enter_context(staged(archive))
        manifest = load_manifest(unpacked)
        if manifest.track != submission.track or task not in manifest.tasks:
            raise ServiceError(
                ProblemCode.MANIFEST_REJECTED,
                f"Expected a submission that plays {task} of {submission.track}, got one to {manifest.track} that "
                f"plays {', '.join(manifest.tasks)}.",
            )
        played = evaluate(
            submission_dir=unpacked,
            track=track,
            task=track.task(task),
            episodes=[episode],
            limits=services.settings.limits,
            secret=None if secret is None else secret_file,
        )
        return Replay(
            record=played.records[0],
            policy_sha256=submission.archive_sha256 if corrected is None else _sha256(corrected),
            corrected=corrected is not None,
        )


def _require_policy(submission: Submission) -> None:
    if not submission.kind.form.runs_policy or load_track(submission.track).has_sensor:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND, "Expected a submission with a policy; a log or a sensor has none."
        )


def _fetched(blobs: BlobStore, submission: Submission, folder: Path) -> Path:
    archive = folder / "submission.zip"
    blobs.fetch(submission.archive_sha256, archive)
    return archive


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
