"""What a rejudgement changes: each of its submissions before and after. Called by `rejudging` and by what shows it."""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime
from uuid import UUID

from sqlalchemy import ColumnElement, exists, select, true
from sqlalchemy.orm import Session, aliased, defer, joinedload
from vitac.evaluator.episodes.records import canonical_json
from vitac.evaluator.ranking import Ranking
from vitac.evaluator.submission_kinds import POLICY_KINDS

from ..competitions.competition import find_stage
from ..competitions.stages import Stage
from ..database.models import Evaluation, Rejudgement, Submission, Team
from ..database.states import TERMINAL_EVALUATION_STATES, EvaluationState
from ..evaluations.scores import combined_score
from ..evaluations.verdicts import ServiceVerdict
from ..leaderboards.best_entries import takes_part
from ..views.decisions import RejudgedSubmissionView, StandingView


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
