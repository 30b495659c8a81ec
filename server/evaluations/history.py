"""The evaluations of a submission, newest first; the newest is the one that it shows.

Those that a rejudgement only proposes are left out.
"""

from collections.abc import Collection
from functools import cache
from typing import TypeVar
from uuid import UUID

from sqlalchemy import ScalarSelect, Select, select
from sqlalchemy.orm import InstrumentedAttribute, Session, defer, undefer
from sqlalchemy.orm.attributes import set_committed_value

from ..database.engine import among_parameter
from ..database.models import Evaluation, Submission
from ..database.states import EvaluationState

ValueT = TypeVar("ValueT")

_NEWEST_FIRST = (Evaluation.created_at.desc(), Evaluation.run.desc(), Evaluation.id)


def newest_evaluation(session: Session, submission: Submission) -> Evaluation:
    """Return the evaluation that a submission shows."""
    return session.scalars(history(submission).limit(1)).one()


def history(submission: Submission) -> Select[Evaluation]:
    """Return the evaluations of a submission, newest first."""
    return all_runs(submission).where(~Evaluation.is_proposed)


def all_runs(submission: Submission) -> Select[Evaluation]:
    """Return the evaluations of a submission with those that are only proposed, newest first."""
    return (
        select(Evaluation)
        .where(Evaluation.submission_id == submission.id)
        .order_by(*_NEWEST_FIRST)
        .execution_options(populate_existing=True)
    )


def histories(
    session: Session, submissions: Collection[Submission], *, with_output: bool = False
) -> dict[UUID, list[Evaluation]]:
    """Return all evaluations of each submission, newest first.

    Args:
        session: of the transaction.
        submissions: whose evaluations.
        with_output: with what their policies printed, which is up to 64 Ki characters each, and could import.
    """
    by_id = {submission.id: submission for submission in submissions}
    found: dict[UUID, list[Evaluation]] = {submission_id: [] for submission_id in by_id}
    for evaluation in session.scalars(_select_evaluations(with_output), {"submissions": list(found)}):
        set_committed_value(evaluation, "submission", by_id[evaluation.submission_id])
        found[evaluation.submission_id].append(evaluation)
    return found


@cache
def _select_evaluations(with_output: bool) -> Select[Evaluation]:
    """Return the query of the evaluations of `submissions`, put together once: each page of submissions asks it."""
    output = (undefer(Evaluation.packages),) if with_output else (defer(Evaluation.log_tail),)
    return (
        select(Evaluation)
        .where(among_parameter(Evaluation.submission_id, "submissions"), ~Evaluation.is_proposed)
        .options(*output)
        .order_by(*_NEWEST_FIRST)
        .execution_options(populate_existing=True)
    )


def newest_state() -> ScalarSelect[EvaluationState]:
    """Return the state of the newest evaluation of a row of `submissions`, for a query on them."""
    return select_newest(Evaluation.state)


def select_newest(column: InstrumentedAttribute[ValueT]) -> ScalarSelect[ValueT]:
    """Return a column of the newest evaluation of a row of `submissions`, for a query on them."""
    return (
        select(column)
        .where(Evaluation.submission_id == Submission.id, ~Evaluation.is_proposed)
        .order_by(Evaluation.created_at.desc(), Evaluation.run.desc())
        .limit(1)
        .scalar_subquery()
    )
