"""Episodes that are played again for an appeal: asked for by an organizer, played by a worker, kept beside the result.

Nothing of the stored records or the boards is touched.
"""

import hashlib
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import update
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.isolation_kinds import IsolationKind
from vitac.evaluator.submission.manifest import load_manifest
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track

from ..audit import record
from ..competitions.competition import find_stage
from ..database.models import AppealReplay, Submission
from ..database.states import WorkKind, WorkState
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..queue.work import Claim, end, lock_held, name_requirement, waiting
from ..services import Services
from ..storage import stored_files
from ..storage.blobs import BlobStore
from ..tracks import find_family
from ..views.correspondence import AppealReplayView
from .appeals import find, require_episode

LOOK_S = 0.2
"""Time between two looks at a replay that somebody waits for."""


@dataclass(frozen=True, kw_only=True)
class ReplayLease(Claim):
    """The right to play one episode again, and all that is needed for it.

    Attributes:
        policy_sha256: of the archive or image that is played.
        policy_kind: what it is.
        commitment: of the sealed list that was played; None for the public one.
        isolation: that the stage asks for.
    """

    policy_sha256: str
    policy_kind: SubmissionKind
    evaluator_version: str
    track: str
    task: str
    episode: int
    commitment: str | None
    isolation: IsolationKind | None


def ask(
    session: Session,
    blobs: BlobStore,
    by: Principal,
    appeal_id: int,
    *,
    task: str,
    episode: int,
    corrected: Path | None = None,
) -> AppealReplay:
    """Have an episode played again, before all evaluations that wait.

    Args:
        session: of the transaction.
        blobs: where the corrected policy is stored.
        by: an organizer.
        appeal_id: for which appeal.
        task: of the submission.
        episode: number in the list that the evaluation played.
        corrected: zip with another policy; None: the submission's.

    Raises:
        ServiceError: not an organizer, there is no such appeal or episode, it is about a log or a sensor, or the
            corrected policy does not play the task.
    """
    by.require_organizer(by.competition)
    appeal = find(session, by, appeal_id)
    stored = require_episode(session, appeal.evaluation, task, episode)
    submission = appeal.evaluation.submission
    _require_policy(submission)
    policy = submission.archive_sha256
    if corrected is not None:
        _require_plays(corrected, submission.track, task)
        policy = hashlib.sha256(corrected.read_bytes()).hexdigest()
        stored_files.store(session, blobs, corrected, policy)
    evaluation = appeal.evaluation
    family, is_sealed = find_family(submission.track, task), evaluation.commitment is not None
    isolation = find_stage(session, submission).rules.isolation
    requires = name_requirement(
        evaluation.evaluator_version,
        family,
        sealed=is_sealed,
        isolation=isolation,
        needs_gpu=submission.needs_gpu,
    )
    replay = AppealReplay(
        appeal_id=appeal.id,
        task=task,
        episode=episode,
        policy_sha256=policy,
        corrected=corrected is not None,
        old_outcome=stored.outcome,
        old_env_steps=stored.env_steps,
        **waiting(session, WorkKind.REPLAY, owner=f"appeal:{appeal.id}", requires=requires),
    )
    session.add(replay)
    session.flush()
    after = {"task": task, "episode": episode, "policy": policy, "corrected": replay.corrected}
    before = {"outcome": stored.outcome, "env_steps": stored.env_steps}
    record(session, by, "appeal.replay", f"appeal:{appeal.id}", after, before=before)
    return replay


def wait(services: Services, replay_id: int) -> AppealReplayView:
    """Wait until an episode was played again, and return what it gave.

    Raises:
        ServiceError: machines could not play it.
    """
    while True:
        with services.database.transaction() as session:
            replay = session.get_one(AppealReplay, replay_id)
            if replay.state is WorkState.DONE:
                return AppealReplayView.model_validate(replay, from_attributes=True)
            if replay.state is WorkState.FAILED:
                raise ServiceError(ProblemCode.INTERNAL_ERROR, f"The episode was not played again. {replay.problem}")
        time.sleep(LOOK_S)


def begin(session: Session, claim: Claim) -> ReplayLease:
    """Return the lease on a claimed replay."""
    replay = session.get_one(AppealReplay, claim.work_id)
    evaluation = replay.appeal.evaluation
    return ReplayLease(
        **vars(claim),
        policy_sha256=replay.policy_sha256,
        policy_kind=SubmissionKind.MODEL if replay.corrected else evaluation.submission.kind,
        evaluator_version=evaluation.evaluator_version,
        track=evaluation.submission.track,
        task=replay.task,
        episode=replay.episode,
        commitment=evaluation.commitment,
        isolation=find_stage(session, evaluation.submission).rules.isolation,
    )


def end_played(session: Session, lease: ReplayLease, played: EpisodeRecord) -> None:
    """Keep what the episode gave, beside the stored result, which stays as it is.

    Raises:
        LeaseLost: the replay is no longer ours.
    """
    lock_held(session, lease)
    evaluation = session.get_one(AppealReplay, lease.work_id).appeal.evaluation
    stored = EpisodeRecord.model_validate(require_episode(session, evaluation, lease.task, lease.episode).record)
    values = {
        "outcome": played.outcome.value,
        "env_steps": played.env_steps,
        "same_states": stored.state_hashes == played.state_hashes,
        "failure": None if played.failure is None else played.failure.message,
    }
    changed = update(AppealReplay).where(AppealReplay.id == lease.work_id).values(**values)
    session.execute(changed.execution_options(synchronize_session=False))
    end(session, lease, WorkState.DONE)


def _require_policy(submission: Submission) -> None:
    if not submission.kind.form.runs_policy or load_track(submission.track).has_sensor:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            "Expected a submission whose policy runs here; a log, a policy server or a sensor has none.",
        )


def _require_plays(archive: Path, track: str, task: str) -> None:
    with ExitStack() as stack:
        manifest = load_manifest(stack.enter_context(staged(archive)))
    if manifest.track != track or task not in manifest.tasks:
        raise ServiceError(
            ProblemCode.MANIFEST_REJECTED,
            f"Expected a submission that plays {task} of {track}, got one to {manifest.track} that plays "
            f"{', '.join(manifest.tasks)}.",
        )
