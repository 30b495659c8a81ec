"""Life of an evaluation: from its start, or the check of its sensor, to its last shard, a cancel, or a failure."""

from collections.abc import Collection, Sequence
from datetime import datetime, timedelta
from itertools import product
from uuid import UUID

from sqlalchemy import ColumnElement, exists, func, select, union_all, update
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeRecord, PolicyFailure, result_hash
from vitac.evaluator.logs.findings import LogFinding
from vitac.evaluator.scoring.score import breaking_failure, score
from vitac.evaluator.shards.order import ShardEnd, ShardResult
from vitac.evaluator.tracks import ListKind, load_track
from vitac.evaluator.tracks.definition import cut
from vitac.evaluator.tracks.registry import compute_hash, find_version

from ..accounts.outbox import announce_evaluation
from ..competitions.competition import find_stage
from ..competitions.sealing import make_fresh_list, throw_away_fresh_list
from ..database.clock import read_clock
from ..database.locks import lock_evaluation
from ..database.models import Evaluation, SensorCheck, Shard, Submission, SubmissionFile, Trial, Work
from ..database.states import OPEN_WORK_STATES, EvaluationState, FileRole, NoticeKind, WorkKind, WorkState
from ..queue.leases import Lease, end_shard
from ..queue.work import UNPLANNED, Claim, end, lock_held, name_requirement, next_turn, waiting
from ..receipts.issuing import issue_for_result
from ..traces import current_traceparent
from ..tracks import find_family
from ..visibility import find_list_kind
from .copies import flag_copies
from .episode_store import count_stored, missing_episodes, played_keys, read_stored_records
from .near_copies import note_archive_copies, note_near_copies
from .provenance import read_provenance
from .scores import Records, combine_hashes, combined_result, store_fresh_scores, store_practice_scores, store_scores
from .verdicts import ServiceVerdict

EVALUATING = (WorkKind.SHARD, WorkKind.TRIAL)
"""Kinds of work by whose turns evaluations take turns."""

FREE_FAILURES_PER_DAY = 5
"""Evaluations of a team within 24 hours that ended by a machine's failure and cost it nothing."""

LOG_TAIL_CHARACTERS = 64 * 1024


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
    makes_sensor: bool = False,
) -> Evaluation:
    """Make an evaluation with its work, all in the caller's transaction.

    Args:
        session: of the transaction.
        submission: what is evaluated.
        run: number of the run.
        charged_at: when the team's quotas counted it; None: organizers asked for it, so it costs nothing.
        turn: its turn; None: the team's next one.
        rejudgement_id: that proposes it; None: it will be the submission's result.
        makes_sensor: whether the submission's sensor is made again, although there is one of an earlier run.
    """
    commitment, owner = _find_commitment(session, submission), f"team:{submission.team_id}"
    evaluation = Evaluation(
        submission=submission,
        run=run,
        evaluator_version=find_version(submission.track),
        evaluator_hash=compute_hash(submission.track),
        state=EvaluationState.QUEUED,
        episodes_reused=0,
        commitment=commitment,
        list_kind=find_list_kind(submission) if commitment is None else ListKind.SEALED,
        turn=next_turn(session, EVALUATING, owner) if turn is None else turn,
        log_tail="",
        charged_at=charged_at,
        asked_by_team=charged_at is not None,
        rejudgement_id=rejudgement_id,
        is_proposed=rejudgement_id is not None,
        traceparent=current_traceparent(),
        created_at=read_clock(session),
    )
    session.add(evaluation)
    session.flush()
    if commitment is not None and find_stage(session, submission).plays_fresh_lists:
        make_fresh_list(session, evaluation)
    if _was_evaluated(session, evaluation, submission):
        evaluation.episodes_reused = sum(count_stored(session, key) for key in played_keys(evaluation, submission))
    if _needs_sensor(session, submission) or (makes_sensor and _brings_sensor(submission)):
        requires = name_requirement(evaluation.evaluator_version)
        columns = waiting(session, WorkKind.SENSOR_CHECK, owner=owner, requires=requires)
        evaluation.sensor_check = SensorCheck(**columns)
    else:
        _add_shards(session, evaluation)
    session.flush()
    return evaluation


def _add_shards(session: Session, evaluation: Evaluation) -> bool:
    """Queue the next of the lists that an evaluation plays; return whether there was one.

    The public list comes first, alone: nothing that a policy does with it, and nothing that its team sees of it, can
    come from an episode of the sealed list.
    """
    submission = evaluation.submission
    queued = set(session.scalars(select(Shard.commitment).where(Shard.evaluation_id == evaluation.id)))
    keys = [key for key in reversed(played_keys(evaluation, submission)) if key.commitment not in queued]
    track, owner = load_track(submission.track), f"team:{submission.team_id}"
    rules = find_stage(session, submission).rules
    for key, task in product(keys[:1], submission.tasks):
        family = find_family(submission.track, task)
        kind = WorkKind.TRIAL if family is Family.STATION else WorkKind.SHARD
        is_sealed = key.commitment != "" and kind is WorkKind.SHARD
        requires = name_requirement(
            evaluation.evaluator_version,
            family,
            sealed=is_sealed,
            isolation=rules.isolation,
            needs_gpu=submission.needs_gpu,
        )
        requires += UNPLANNED if rules.plan else ""
        columns = waiting(session, kind, owner=owner, requires=requires, turn=evaluation.turn)
        for piece in cut(track.task(task)):
            shard = Trial if kind is WorkKind.TRIAL else Shard
            session.add(
                shard(
                    evaluation=evaluation,
                    task=task,
                    number=piece.index,
                    commitment=key.commitment,
                    episodes=sorted(piece.numbers),
                    **columns,
                )
            )
    return bool(keys)


def _brings_sensor(submission: Submission) -> bool:
    return submission.kind.form.runs_policy and load_track(submission.track).has_sensor


def _needs_sensor(session: Session, submission: Submission) -> bool:
    """Return whether a submission brings a sensor that nobody has made yet."""
    is_its_sensor = (SubmissionFile.submission_id == submission.id, SubmissionFile.role == FileRole.SENSOR)
    return _brings_sensor(submission) and not session.scalar(select(exists().where(*is_its_sensor)))


def _find_commitment(session: Session, submission: Submission) -> str | None:
    """Return by which sealed list a submission is ranked; None for a log, which holds actions for the public one."""
    return find_stage(session, submission).commitment if submission.kind.form.runs_policy else None


def _was_evaluated(session: Session, evaluation: Evaluation, submission: Submission) -> bool:
    """Return whether the team itself has had this content evaluated; of other teams' it must not learn."""
    own = Submission.team_id == submission.team_id, Submission.digest == submission.digest
    earlier = exists().where(Evaluation.submission_id == Submission.id, Evaluation.id != evaluation.id, *own)
    return bool(session.scalar(select(earlier)))


def end_check(session: Session, claim: Claim) -> None:
    """End the check of a sensor that is stored by now: its evaluation gets its shards.

    Raises:
        LeaseLost: the check is no longer ours.
    """
    evaluation = _lock_checked(session, claim)
    end(session, claim, WorkState.DONE)
    _add_shards(session, evaluation)


def fail_check(session: Session, claim: Claim, verdict: ServiceVerdict, message: str) -> None:
    """End the check of a sensor that breaks a rule or takes too long, and with it the evaluation.

    Raises:
        LeaseLost: the check is no longer ours.
    """
    evaluation = _lock_checked(session, claim)
    end(session, claim, WorkState.FAILED, problem=message)
    _fail(session, evaluation, verdict, message)


def _lock_checked(session: Session, claim: Claim) -> Evaluation:
    return lock_evaluation(session, session.get_one(SensorCheck, claim.work_id).evaluation_id)


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
    end_shard(session, lease, WorkState.DONE if done else WorkState.FAILED, result)
    if done:
        _require_all_stored(session, lease)
    else:
        # Earlier shards run on: the verdict is the first one's, whatever the order in which they end.
        _cancel_work(session, evaluation, after=lease.work_id)
    if not _has_shards(session, evaluation, OPEN_WORK_STATES):
        is_broken = _has_shards(session, evaluation, {WorkState.FAILED})
        if is_broken or not _add_shards(session, evaluation):
            _conclude(session, evaluation)


def _require_all_stored(session: Session, lease: Lease) -> None:
    missing = missing_episodes(session, lease)
    if missing:
        raise EpisodesMissing(
            f"Shard {lease.work_id} was reported as complete, but its episodes {missing[:10]} are not stored. "
            "Run it again."
        )


def give_up(session: Session, claim: Claim, reason: str) -> None:
    """End work that was tried in all its attempts: that of an evaluation with it, any other alone.

    Raises:
        LeaseLost: the work is no longer ours.
    """
    work = session.get_one(Work, claim.work_id)
    if not isinstance(work, Shard | SensorCheck):
        end(session, claim, WorkState.FAILED, problem=reason)
        return
    evaluation = lock_evaluation(session, work.evaluation_id)
    lock_held(session, claim)  # Only whoever holds the work may end the evaluation.
    fail_by_machines(session, evaluation, f"{work.title}: {reason}")


def fail_by_machines(session: Session, evaluation: Evaluation, message: str) -> None:
    """End an evaluation whose work could not be done in all its attempts; the first ones of a day cost nothing.

    The others cost what each evaluation costs: what makes machines fail would be played for ever otherwise.
    """
    if count_machine_failures(session, Submission.team_id == evaluation.submission.team_id) < FREE_FAILURES_PER_DAY:
        evaluation.charged_at = None
    _cancel_work(session, evaluation)
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
    _cancel_work(session, evaluation)
    throw_away_fresh_list(session, evaluation)
    evaluation.state = EvaluationState.CANCELLED
    evaluation.finished_at = read_clock(session)


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
    by_list = {key.commitment: records for key, records in zip(keys, played, strict=True)}
    if evaluation.commitment and "" in by_list:
        public = {task: read_provenance(session, evaluation, task, "") for task in submission.tasks}
        store_practice_scores(evaluation, track, sealed=played[0], public=by_list[""], manifests=public)
    if evaluation.fresh_commitment:
        store_fresh_scores(evaluation, track, by_list.pop(evaluation.fresh_commitment))
    _complete(session, evaluation, played[0])
    if not evaluation.is_proposed:
        note_near_copies(session, evaluation, by_list)
        if submission.final_of is None:  # whose archive was compared when it was chosen from
            note_archive_copies(session, submission)


def _complete(session: Session, evaluation: Evaluation, records: Records) -> None:
    throw_away_fresh_list(session, evaluation)
    manifests = {task: read_provenance(session, evaluation, task, evaluation.commitment or "") for task in records}
    hashes = {task: result_hash(manifests[task], records[task]) for task in records}
    finished_at = read_clock(session)
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
    throw_away_fresh_list(session, evaluation)
    evaluation.verdict_code = code
    evaluation.verdict_message = message
    evaluation.state = EvaluationState.FAILED
    evaluation.finished_at = read_clock(session)
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


def _cancel_work(session: Session, evaluation: Evaluation, after: int = 0) -> None:
    ids = union_all(*(select(kind.id).where(kind.evaluation_id == evaluation.id) for kind in (Shard, SensorCheck)))
    session.execute(
        update(Work)
        .where(Work.id.in_(ids), Work.id > after, Work.state.in_(OPEN_WORK_STATES))
        .values(state=WorkState.CANCELLED, lease_expires_at=None, finished_at=func.clock_timestamp())
        .execution_options(synchronize_session=False)
    )


def _has_shards(session: Session, evaluation: Evaluation, states: Collection[WorkState]) -> bool:
    of_evaluation = Shard.evaluation_id == evaluation.id, Shard.state.in_(states)
    return session.scalar(select(Shard.id).where(*of_evaluation).limit(1)) is not None
