"""Life of an evaluation: started with its shards, ended by its last shard, a cancel, or machines that fail."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from itertools import product
from uuid import UUID

from sqlalchemy import ColumnElement, exists, func, select, update
from sqlalchemy.orm import Session
from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeRecord, PolicyFailure, result_hash
from vitac.evaluator.logs.findings import LogFinding
from vitac.evaluator.scoring.failures import breaking_failure
from vitac.evaluator.scoring.score import score
from vitac.evaluator.shards.order import ShardEnd, ShardResult
from vitac.evaluator.tracks import ListKind, load_track
from vitac.evaluator.tracks.cut import cut
from vitac.evaluator.tracks.registry import compute_hash, find_version

from ..accounts.outbox import announce_evaluation
from ..competitions.competition import find_stage
from ..database.locks import lock_evaluation
from ..database.models import Evaluation, Shard, Submission
from ..database.states import OPEN_SHARD_STATES, EvaluationState, NoticeKind, ShardState
from ..queue.jobs import enqueue_shards, queue_name, withdraw_jobs
from ..queue.leases import Lease, end_shard, hand_back, lock_held
from ..queue.turns import next_turn
from ..receipts.issuing import issue_for_result
from ..settings import Settings
from ..traces import current_traceparent
from ..tracks import find_family
from ..visibility import find_list_kind
from .archive_copies import note_archive_copies
from .copies import flag_copies
from .episode_store import count_stored, missing_episodes, played_keys, read_stored_records
from .near_copies import note_near_copies
from .provenance import read_provenance
from .scores import Records, combine_hashes, combined_result, store_practice_scores, store_scores
from .verdicts import ServiceVerdict

FREE_FAILURES_PER_DAY = 5
"""Evaluations of a team within 24 hours that ended by a machine's failure and cost it nothing."""

LOG_TAIL_CHARACTERS = 64 * 1024
RETRY_DELAY_S = 2.0
"""Pause before the second attempt of a shard that a machine could not run; the third comes after twice as long."""


class EpisodesMissing(VitacError):
    """A shard was reported as complete without all its episodes; it is run again."""


class WrongEvaluator(VitacError):
    """A worker of another evaluator version took a shard: restart it with the version of the server."""


def start(
    session: Session,
    submission: Submission,
    run: int,
    *,
    charged_at: datetime | None = None,
    turn: int | None = None,
    rejudgement_id: UUID | None = None,
) -> Evaluation:
    """Make an evaluation with its shards and their jobs, all in the caller's transaction.

    Args:
        session: of the transaction.
        submission: what is evaluated.
        run: number of the run.
        charged_at: when the team's quotas counted it; None: organizers asked for it, so it costs nothing.
        turn: its turn; None: the team's next one.
        rejudgement_id: that proposes it; None: it will be the submission's result.
    """
    commitment = _find_commitment(session, submission)
    evaluation = Evaluation(
        submission=submission,
        run=run,
        evaluator_version=find_version(submission.track),
        evaluator_hash=compute_hash(submission.track),
        state=EvaluationState.QUEUED,
        episodes_reused=0,
        commitment=commitment,
        list_kind=find_list_kind(submission) if commitment is None else ListKind.SEALED,
        turn=next_turn(session, submission.team_id) if turn is None else turn,
        log_tail="",
        charged_at=charged_at,
        asked_by_team=charged_at is not None,
        rejudgement_id=rejudgement_id,
        is_proposed=rejudgement_id is not None,
        traceparent=current_traceparent(),
        created_at=datetime.now(UTC),
    )
    track, keys = load_track(submission.track), played_keys(evaluation, submission)
    for key, task in product(keys, submission.tasks):
        for piece in cut(track.task(task)):
            evaluation.shards.append(
                Shard(
                    task=task,
                    number=piece.index,
                    commitment=key.commitment,
                    episodes=sorted(piece.numbers),
                    state=ShardState.QUEUED,
                    token=0,
                    attempts=0,
                )
            )
    session.add(evaluation)
    session.flush()
    if _was_evaluated(session, evaluation, submission):
        evaluation.episodes_reused = sum(count_stored(session, key) for key in keys)
    for task in submission.tasks:
        ids = [shard.id for shard in evaluation.shards if shard.task == task]
        queue = queue_name(evaluation.evaluator_version, find_family(submission.track, task))
        enqueue_shards(session, ids, queue, priority=-evaluation.turn)
    return evaluation


def _find_commitment(session: Session, submission: Submission) -> str | None:
    """Return by which sealed list a submission is ranked; None for a log, which holds actions for the public one."""
    return find_stage(session, submission).commitment if submission.kind.form.runs_policy else None


def _was_evaluated(session: Session, evaluation: Evaluation, submission: Submission) -> bool:
    """Return whether the team itself has had this content evaluated; of other teams' it must not learn."""
    own = Submission.team_id == submission.team_id, Submission.digest == submission.digest
    earlier = exists().where(Evaluation.submission_id == Submission.id, Evaluation.id != evaluation.id, *own)
    return bool(session.scalar(select(earlier)))


def finish_shard(session: Session, lease: Lease, result: ShardResult) -> None:
    """End a shard, and with the last one the evaluation: scores and state change in this one transaction.

    Raises:
        LeaseLost: the shard is no longer ours.
        EpisodesMissing: it is not complete.
        WrongEvaluator: it was run by another evaluator version.
    """
    evaluation = lock_evaluation(session, lease.evaluation_id)
    if result.manifest.evaluator_version != evaluation.evaluator_version:
        raise WrongEvaluator(
            f"The worker runs evaluator {result.manifest.evaluator_version}, the evaluation needs "
            f"{evaluation.evaluator_version}. Restart the worker."
        )
    done = result.end is ShardEnd.COMPLETE
    end_shard(session, lease, ShardState.DONE if done else ShardState.FAILED, result)
    if done:
        _require_all_stored(session, lease)
    else:
        # Earlier shards run on: the verdict is the first one's, whatever the order in which they end.
        _cancel_shards(session, evaluation, after=lease.shard_id)
    if not _count_open_shards(session, evaluation):
        _conclude(session, evaluation)


def _require_all_stored(session: Session, lease: Lease) -> None:
    missing = missing_episodes(session, lease)
    if missing:
        raise EpisodesMissing(
            f"Shard {lease.shard_id} was reported as complete, but its episodes {missing[:10]} are not stored. "
            "Run it again."
        )


def report_broken_machine(session: Session, settings: Settings, lease: Lease, message: str) -> None:
    """Queue a shard again that a machine, not the policy, has failed; after the last attempt, end its evaluation.

    Attempts in which an episode was stored do not count: infrastructure ends no evaluation as long as it moves.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    evaluation = lock_evaluation(session, lease.evaluation_id)
    attempts = lock_held(session, lease)  # Only whoever holds the shard may end the evaluation.
    if attempts < settings.shard_attempts:
        hand_back(session, lease, counts_as_attempt=True, delay_s=max(1, attempts) * RETRY_DELAY_S, broke=message)
        return
    first, last = lease.episodes[0], lease.episodes[-1]
    fail_by_machines(
        session,
        evaluation,
        f"Episodes {first} to {last} of {lease.task} were tried {attempts} times without any progress. "
        f"The last time: {message}",
    )


def fail_by_machines(session: Session, evaluation: Evaluation, message: str) -> None:
    """End an evaluation whose shard could not be run in all its attempts; the first ones of a day cost nothing.

    The others cost what each evaluation costs: what makes machines fail would be played for ever otherwise.
    """
    if count_machine_failures(session, Submission.team_id == evaluation.submission.team_id) < FREE_FAILURES_PER_DAY:
        evaluation.charged_at = None
    _cancel_shards(session, evaluation)
    _fail(session, evaluation, ServiceVerdict.MACHINE_FAILED, message)


def count_machine_failures(session: Session, *conditions: ColumnElement[bool]) -> int:
    """Return how many evaluations that teams asked for machines have ended in the last 24 hours."""
    query = select(func.count()).select_from(Evaluation).join(Submission)
    by_machines = Evaluation.verdict_code == ServiceVerdict.MACHINE_FAILED
    since = func.now() - timedelta(days=1)
    recent = Evaluation.finished_at > since
    return session.scalar(query.where(by_machines, Evaluation.asked_by_team, recent, *conditions)) or 0


def cancel(session: Session, evaluation: Evaluation) -> None:
    """End a queued or running evaluation; its workers find out at their next renewal."""
    _cancel_shards(session, evaluation)
    evaluation.state = EvaluationState.CANCELLED
    evaluation.finished_at = datetime.now(UTC)


def first_refuted_shard(session: Session, evaluation: Evaluation) -> Shard | None:
    """Return the first shard in which an uploaded log was found to be untrue, in the order of the list."""
    return session.scalars(
        select(Shard)
        .where(Shard.evaluation_id == evaluation.id, Shard.finding.is_not(None))
        .order_by(Shard.id)
        .limit(1)
        .execution_options(populate_existing=True)
    ).first()


def _conclude(session: Session, evaluation: Evaluation) -> None:
    """Score a finished evaluation, or give it the verdict of its first shard that broke a policy or refuted a log."""
    refuted = first_refuted_shard(session, evaluation)
    if refuted is not None:
        _fail_by_log(session, evaluation, refuted)
        return
    submission = evaluation.submission
    track = load_track(submission.track)
    keys = played_keys(evaluation, submission)
    played = [{task: read_stored_records(session, key, task) for task in submission.tasks} for key in keys]
    evaluation.log_tail = _collect_output(played[0])
    for records, task in product(played, submission.tasks):
        failure = breaking_failure(cut(track.task(task)), records[task])
        if failure is not None:
            _fail_by_policy(session, evaluation, task, failure, records[task])
            return
    if len(played) > 1:
        public = {task: read_provenance(session, evaluation, task, "") for task in submission.tasks}
        store_practice_scores(evaluation, track, sealed=played[0], public=played[1], manifests=public)
    _complete(session, evaluation, played[0])
    if not evaluation.is_proposed:
        by_list = {key.commitment: records for key, records in zip(keys, played, strict=True)}
        note_near_copies(session, evaluation, by_list)
        note_archive_copies(session, submission)


def _complete(session: Session, evaluation: Evaluation, records: Records) -> None:
    manifests = {task: read_provenance(session, evaluation, task, evaluation.commitment or "") for task in records}
    hashes = {task: result_hash(manifests[task], records[task]) for task in records}
    finished_at = datetime.now(UTC)
    track = load_track(evaluation.submission.track)
    scores = {task: score(records[task], track.task(task).definition.measures) for task in records}
    store_scores(session, evaluation, scores, hashes, finished_at=finished_at)
    evaluation.result_hash = combine_hashes(hashes)
    evaluation.platform_class = next(iter(manifests.values())).platform_class
    evaluation.state = EvaluationState.COMPLETED
    evaluation.finished_at = finished_at
    session.flush()
    if not evaluation.is_proposed:
        flag_copies(session, evaluation)
        announce_evaluation(session, NoticeKind.FINISHED, evaluation)
        issue_for_result(session, evaluation, combined_result(evaluation))


def _fail_by_policy(
    session: Session, evaluation: Evaluation, task: str, failure: PolicyFailure, records: Sequence[EpisodeRecord]
) -> None:
    episode = next(record.episode for record in records if record.failure == failure)
    evaluation.verdict_task = task
    evaluation.verdict_episode = episode
    evaluation.log_tail = failure.output_tail[-LOG_TAIL_CHARACTERS:]
    _fail(session, evaluation, failure.code.value, failure.message)


def _fail_by_log(session: Session, evaluation: Evaluation, shard: Shard) -> None:
    finding = LogFinding.model_validate(shard.finding)
    evaluation.verdict_task = shard.task
    evaluation.verdict_episode = finding.episode
    _fail(session, evaluation, ServiceVerdict(finding.verdict.value), finding.reason)


def _fail(session: Session, evaluation: Evaluation, code: str, message: str) -> None:
    evaluation.verdict_code = code
    evaluation.verdict_message = message
    evaluation.state = EvaluationState.FAILED
    evaluation.finished_at = datetime.now(UTC)
    if not evaluation.is_proposed:
        announce_evaluation(session, NoticeKind.FAILED, evaluation)


def _collect_output(records: Records) -> str:
    """Return what the policy printed in the few episodes that it failed in, the last ones if that is too much."""
    parts = [
        f"[{task}, episode {record.episode}: {record.failure.code}]\n{record.failure.output_tail}\n"
        for task, of_task in records.items()
        for record in of_task
        if record.failure is not None
    ]
    return "".join(parts)[-LOG_TAIL_CHARACTERS:]


def _cancel_shards(session: Session, evaluation: Evaluation, after: int = 0) -> None:
    ended = session.scalars(
        update(Shard)
        .where(Shard.evaluation_id == evaluation.id, Shard.id > after, Shard.state.in_(OPEN_SHARD_STATES))
        .values(state=ShardState.CANCELLED, lease_expires_at=None, finished_at=func.clock_timestamp())
        .returning(Shard.id)
        .execution_options(synchronize_session=False)
    ).all()
    withdraw_jobs(session, ended)


def _count_open_shards(session: Session, evaluation: Evaluation) -> int:
    query = select(func.count()).select_from(Shard)
    return session.scalar(query.where(Shard.evaluation_id == evaluation.id, Shard.state.in_(OPEN_SHARD_STATES))) or 0
