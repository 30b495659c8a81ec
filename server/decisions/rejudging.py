"""Rejudging: evaluates stored submissions again by another version, compares, and applies or discards it."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from uuid import UUID

from sqlalchemy import ColumnElement, delete, exists, select, true
from sqlalchemy.orm import Session, aliased, defer, joinedload
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.ranking import Ranking
from vitac.evaluator.submission_kinds import POLICY_KINDS
from vitac.evaluator.tracks.registry import find_version

from .. import names
from ..accounts.outbox import announce_evaluation
from ..audit import record
from ..competitions.competition import Competition, find_stage
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.engine import among
from ..database.locks import lock_evaluation
from ..database.models import BoardResult, Evaluation, Rejudgement, Submission, Team
from ..database.states import ACTIVE_EVALUATION_STATES, TERMINAL_EVALUATION_STATES, EvaluationState, NoticeKind
from ..errors import ProblemCode, ServiceError, not_found
from ..evaluations import lifecycle
from ..evaluations.copies import flag_copies
from ..evaluations.episode_store import read_played_records
from ..evaluations.history import all_runs
from ..evaluations.near_copies import note_near_copies
from ..evaluations.scores import add_to_boards, combined_result, combined_score
from ..evaluations.verdicts import ServiceVerdict
from ..leaderboards.best_entries import takes_part
from ..principals import Principal
from ..receipts.issuing import issue_for_result
from ..tracks import load_known_track
from ..transparency.entries import RejudgementApplied
from ..transparency.log import append
from ..views.decisions import RejudgedSubmissionView, RejudgementDetailView, RejudgementView, StandingView

REASON_LENGTH = 500


def start(
    session: Session, by: Principal, stage: Stage, *, submissions: Collection[UUID] = (), reason: str
) -> Rejudgement:
    """Evaluate models of a stage again with the present evaluator, beside the results that they have.

    Args:
        session: of the transaction.
        by: an organizer.
        stage: of the submissions.
        submissions: which ones; none: all models of the stage whose team takes part and whose tasks are there.
        reason: for the audit log.

    Raises:
        ServiceError: not an organizer, the reason cannot be shown, the competition is final, nothing is to be
            evaluated, a submission is none of the stage's models, or is being evaluated.
    """
    by.require_organizer(stage.competition)
    shown_reason = names.clean(reason, what="A reason", min_length=1, max_length=REASON_LENGTH)
    _lock_competition(session, stage.competition)
    chosen = _chosen(session, stage, submissions)
    made = Rejudgement(**stage.place, reason=shown_reason)
    session.add(made)
    session.flush()
    for submission in chosen:
        runs = session.scalars(all_runs(submission)).all()
        if any(run.state in ACTIVE_EVALUATION_STATES for run in runs):
            raise ServiceError(
                ProblemCode.NOT_REQUEUABLE,
                f"Submission {submission.id} of {submission.team.name} is being evaluated; wait or cancel.",
            )
        run = 1 + max((run.run for run in runs if run.evaluator_version == find_version(stage.track)), default=0)
        lifecycle.start(session, submission, run, rejudgement_id=made.id)
    after = {
        "track": stage.track,
        "stage": stage.name,
        "submissions": [str(submission.id) for submission in chosen],
        "evaluator_version": find_version(stage.track),
        "reason": shown_reason,
    }
    record(session, by, "rejudgement.start", _subject(made), after)
    return made


def find(session: Session, by: Principal, rejudgement_id: UUID) -> Rejudgement:
    """Return a rejudgement.

    Raises:
        ServiceError: not an organizer, or there is none of that id that the principal may see.
    """
    by.require_organizer(by.competition)
    rejudgement = session.get(Rejudgement, rejudgement_id)
    if rejudgement is None or not by.organizes(rejudgement.competition):
        raise not_found("rejudgement", rejudgement_id)
    return rejudgement


def rejudgements(session: Session, by: Principal) -> Sequence[Rejudgement]:
    """Return all rejudgements that an organizer may see, newest first.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    query = select(Rejudgement).order_by(Rejudgement.started_at.desc(), Rejudgement.id)
    return session.scalars(
        query if by.competition is None else query.where(Rejudgement.competition == by.competition)
    ).all()


def set_aside(session: Session, evaluations: Collection[UUID]) -> tuple[UUID, ...]:
    """Return those of some evaluations that an applied rejudgement has taken off the boards, by id."""
    newer = aliased(Evaluation)
    is_replaced = exists().where(
        newer.submission_id == Evaluation.submission_id,
        newer.rejudgement_id.is_not(None),
        ~newer.is_proposed,
        newer.created_at > Evaluation.created_at,
    )
    rows = session.scalars(select(Evaluation.id).where(among(Evaluation.id, evaluations), is_replaced))
    return tuple(sorted(rows))


def apply(
    session: Session, by: Principal, rejudgement_id: UUID, *, shown: str | None = None
) -> list[RejudgedSubmissionView]:
    """Make the new results those of their submissions, with a receipt each; the present ones leave the boards.

    What machines failed or somebody cancelled keeps its present result, and so does what was evaluated again since
    the rejudgement began: that result is the newer one.

    Args:
        session: of the transaction.
        by: an organizer.
        rejudgement_id: which one.
        shown: the revision of what was seen before (`compute_revision`); None: whatever it is now.

    Raises:
        ServiceError: not an organizer, no such rejudgement, it has ended, the competition is final or its boards
            are frozen, an evaluation waits or runs, or something has changed since it was shown.
    """
    rejudgement = _lock_open(session, by, rejudgement_id)
    _lock_competition(session, rejudgement.competition)
    stage = find_stage(session, rejudgement)
    if stage.frozen_at is not None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"The boards have been frozen since {stage.frozen_at:%F %T} UTC, and this would change them; run "
            "`vitac admin results unfreeze` first.",
        )
    rows = comparison(session, rejudgement)
    going_on = [row.team for row in rows if row.state not in TERMINAL_EVALUATION_STATES]
    if going_on:
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Expected no evaluation of the rejudgement that waits or runs, got {len(going_on)}; wait, or discard it.",
        )
    if shown is not None and shown != compute_revision(rows):
        raise ServiceError(
            ProblemCode.RESULTS_OUTDATED,
            "Something has changed since you looked, so nothing was applied. Check it and try again.",
        )
    now = read_clock(session)
    # By id: an evaluation of another rejudgement is locked in the same order.
    chosen = sorted(find_newest_evaluations(session, rejudgement).values(), key=lambda evaluation: evaluation.id)
    keeping = {row.submission for row in rows if row.keeps_result}
    replacing = [lock_evaluation(session, one.id) for one in chosen if one.submission_id not in keeping]
    completed = [evaluation for evaluation in replacing if evaluation.state is EvaluationState.COMPLETED]
    for evaluation in replacing:
        evaluation.is_proposed = False
        session.execute(delete(BoardResult).where(BoardResult.submission_id == evaluation.submission_id))
        kind = NoticeKind.FINISHED if evaluation.state is EvaluationState.COMPLETED else NoticeKind.FAILED
        announce_evaluation(session, kind, evaluation)
    for evaluation in completed:
        add_to_boards(session, evaluation, now)
        session.flush()
        flag_copies(session, evaluation)
        note_near_copies(session, evaluation, read_played_records(session, evaluation))
    rejudgement.applied_at = now
    record(
        session,
        by,
        "rejudgement.apply",
        _subject(rejudgement),
        _audited(rows, "after"),
        before=_audited(rows, "before"),
    )
    append(  # last of all, with the receipts: an entry of the log locks out all others
        session,
        lambda at: RejudgementApplied(
            **stage.place,
            issued_at=at,
            rejudgement=rejudgement.id,
            replaced=len(completed),
            withdrawn=len(replacing) - len(completed),
        ),
    )
    for evaluation in completed:
        issue_for_result(session, evaluation, combined_result(evaluation))
    return rows


def discard(session: Session, by: Principal, rejudgement_id: UUID) -> None:
    """Leave all present results as they are; what still waits or runs is cancelled.

    Raises:
        ServiceError: not an organizer, no such rejudgement, or it has ended.
    """
    rejudgement = _lock_open(session, by, rejudgement_id)
    for evaluation in sorted(
        find_newest_evaluations(session, rejudgement).values(), key=lambda evaluation: evaluation.id
    ):
        locked = lock_evaluation(session, evaluation.id)
        if locked.state in ACTIVE_EVALUATION_STATES:
            lifecycle.cancel(session, locked)
    rejudgement.discarded_at = read_clock(session)
    record(session, by, "rejudgement.discard", _subject(rejudgement), {"discarded": True})


def _chosen(session: Session, stage: Stage, ids: Collection[UUID]) -> Sequence[Submission]:
    query = (
        select(Submission)
        .join(Team)
        .where(
            stage.submissions,
            Submission.kind.in_(POLICY_KINDS),
            Team.erased_at.is_(None),
            exists().where(Evaluation.submission_id == Submission.id),
        )
        .order_by(Submission.submitted_at, Submission.id)
        .with_for_update(key_share=True, of=Submission)
    )
    known = query.where(takes_part(), Submission.tasks.contained_by(list(load_known_track(stage.track).tasks)))
    chosen = session.scalars(query.where(Submission.id.in_(ids)) if ids else known).all()
    missing = set(ids) - {submission.id for submission in chosen}
    if missing or not chosen:
        what = f"submission {min(missing)}" if missing else "any submission"
        raise ServiceError(
            ProblemCode.NOT_FOUND,
            f"Expected models of {stage}, but {what} is none. Logs cannot be evaluated again, and uploads that were "
            "removed with their team neither.",
        )
    return chosen


def _lock_open(session: Session, by: Principal, rejudgement_id: UUID) -> Rejudgement:
    by.require_organizer(by.competition)
    rejudgement = session.get(Rejudgement, rejudgement_id, with_for_update=True, populate_existing=True)
    if rejudgement is None or not by.organizes(rejudgement.competition):
        raise not_found("rejudgement", rejudgement_id)
    if rejudgement.applied_at or rejudgement.discarded_at:
        how = "applied" if rejudgement.applied_at else "discarded"
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE, f"Rejudgement {rejudgement.id} was {how} already; start another one."
        )
    return rejudgement


def _lock_competition(session: Session, name: str) -> None:
    """Refuse after the end; from here on the competition is neither ended nor frozen meanwhile."""
    Competition.lock(session, name, shared=True).require_not_final()


def _audited(rows: Sequence[RejudgedSubmissionView], side: str) -> dict[str, object]:
    return {str(row.submission): getattr(row, side).model_dump() for row in rows if not row.keeps_result}


def _subject(rejudgement: Rejudgement) -> str:
    return f"rejudgement:{rejudgement.id}"


def rejudgement_view(rejudgement: Rejudgement) -> RejudgementView:
    """Return a rejudgement without its submissions."""
    return RejudgementView.from_row(
        rejudgement, competition=rejudgement.competition or None, stage=rejudgement.stage or None
    )


def rejudgement_detail_view(
    session: Session, rejudgement: Rejudgement, rows: Sequence[RejudgedSubmissionView] | None = None
) -> RejudgementDetailView:
    """Return a rejudgement with its submissions; `rows`: as they were compared before it was applied."""
    compared = comparison(session, rejudgement) if rows is None else rows
    return RejudgementDetailView(
        **dict(rejudgement_view(rejudgement)),
        revision=compute_revision(compared),
        submissions=list(compared),
    )


def comparison(session: Session, rejudgement: Rejudgement) -> list[RejudgedSubmissionView]:
    """Return each submission before and after, those that change first.

    Ranks are those among all models of the stage as if every evaluator version counted alike, so that a board from
    before an upgrade can be compared with the one after it. Of a rejudgement that has ended, results are compared as
    they were then, among the teams that take part now.
    """
    new, kept = find_newest_evaluations(session, rejudgement), _find_newer_evaluations(session, rejudgement)
    stage = find_stage(session, rejudgement)
    present, ranking = _present(session, rejudgement, stage), stage.find_ranking()
    replaced = {submission: run for submission, run in new.items() if not _keeps_result(run, kept)}
    ranks_before, ranks_after = _ranks(present, ranking), _ranks({**present, **replaced}, ranking)
    rows = [
        _compared(
            evaluation,
            present.get(submission),
            (ranks_before.get(submission), ranks_after.get(submission)),
            keeps_result=_keeps_result(evaluation, kept),
        )
        for submission, evaluation in new.items()
    ]
    return sorted(
        rows, key=lambda row: (not row.changes, row.after.rank or len(rows) + 1, row.team, str(row.submission))
    )


def compute_revision(rows: Sequence[RejudgedSubmissionView]) -> str:
    """Return what changes whenever applying a rejudgement would do something else."""
    content = {str(row.submission): row.model_dump() | {"submission": None} for row in rows}
    return hashlib.sha256(canonical_json(content)).hexdigest()


def _find_newer_evaluations(session: Session, rejudgement: Rejudgement) -> frozenset[UUID]:
    """Return the submissions with an evaluation of their own, or by an applied rejudgement, that began after it."""
    proposed, newer = aliased(Evaluation), aliased(Evaluation)
    rows = session.scalars(
        select(newer.submission_id)
        .join(proposed, proposed.submission_id == newer.submission_id)
        .where(
            proposed.rejudgement_id == rejudgement.id,
            *_counted(newer, rejudgement),
            newer.created_at > rejudgement.started_at,
        )
    )
    return frozenset(rows)


def find_newest_evaluations(session: Session, rejudgement: Rejudgement) -> Mapping[UUID, Evaluation]:
    """Return the newest evaluation of each submission in a rejudgement: one may have begun again after an upgrade."""
    rows = session.scalars(
        select(Evaluation)
        .where(Evaluation.rejudgement_id == rejudgement.id)
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission).joinedload(Submission.team))
        .order_by(Evaluation.created_at, Evaluation.run)
        .execution_options(populate_existing=True)
    )
    return {evaluation.submission_id: evaluation for evaluation in rows}


def _present(session: Session, rejudgement: Rejudgement, stage: Stage) -> Mapping[UUID, Evaluation]:
    """Return the newest result of each model of the stage whose team takes part, beside this rejudgement's own."""
    ended = _find_end(rejudgement)
    rows = session.scalars(
        select(Evaluation)
        .join(Submission)
        .join(Team)
        .where(
            stage.submissions,
            Submission.kind.in_(POLICY_KINDS),
            Evaluation.state == EvaluationState.COMPLETED,
            *_counted(Evaluation, rejudgement),
            true() if ended is None else Evaluation.finished_at < ended,
            takes_part(),
        )
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission).joinedload(Submission.team))
        .order_by(Evaluation.created_at, Evaluation.run)
    )
    return {evaluation.submission_id: evaluation for evaluation in rows}


def _counted(evaluation: type[Evaluation], rejudgement: Rejudgement) -> tuple[ColumnElement[bool], ...]:
    """Return whether an evaluation is no other rejudgement's proposal and not of this one: now, or at its end."""
    conditions = (~evaluation.is_proposed, evaluation.rejudgement_id.is_distinct_from(rejudgement.id))
    ended = _find_end(rejudgement)
    if ended is None:
        return conditions
    applied_later = exists().where(Rejudgement.id == evaluation.rejudgement_id, Rejudgement.applied_at > ended)
    return (*conditions, evaluation.created_at < ended, ~applied_later)


def _find_end(rejudgement: Rejudgement) -> datetime | None:
    return rejudgement.applied_at or rejudgement.discarded_at


def _ranks(results: Mapping[UUID, Evaluation], ranking: Ranking) -> dict[UUID, int]:
    """Return the rank of each submission that is its team's best."""
    scored = [(evaluation, combined_score(evaluation)) for evaluation in results.values()]
    in_order = sorted(
        (ranking.sort_key(ranking.values(score, evaluation.submission.submitted_at)), evaluation.id, evaluation)
        for evaluation, score in scored
        if score is not None
    )
    best: dict[UUID, UUID] = {}
    for *_, evaluation in in_order:
        best.setdefault(evaluation.submission.team_id, evaluation.submission_id)
    return {submission: rank for rank, submission in enumerate(best.values(), start=1)}


def _compared(
    new: Evaluation, old: Evaluation | None, ranks: tuple[int | None, int | None], *, keeps_result: bool
) -> RejudgedSubmissionView:
    before, after = _standing(old, ranks[0]), _standing(new, ranks[1])
    same = all(
        getattr(before, name) == getattr(after, name) for name in ("success_rate", "mean_steps", "rank", "verdict")
    )
    return RejudgedSubmissionView(
        team=new.submission.team.name,
        submission=new.submission_id,
        name=new.submission.name,
        state=new.state,
        before=before,
        after=after,
        changes=new.state in TERMINAL_EVALUATION_STATES and not keeps_result and not same,
        keeps_result=keeps_result,
    )


def _standing(evaluation: Evaluation | None, rank: int | None) -> StandingView:
    score = combined_score(evaluation) if evaluation else None
    return StandingView(
        success_rate=score.success_rate if score else None,
        mean_steps=score.mean_steps if score else None,
        rank=rank,
        evaluator_version=evaluation.evaluator_version if evaluation else None,
        verdict=evaluation.verdict_code if evaluation else None,
    )


def _keeps_result(evaluation: Evaluation, kept: Collection[UUID]) -> bool:
    """Return whether the result of a proposed evaluation is not taken; `kept`: submissions with a newer one."""
    by_machines = evaluation.verdict_code == ServiceVerdict.MACHINE_FAILED.value
    return evaluation.submission_id in kept or evaluation.state is EvaluationState.CANCELLED or by_machines
