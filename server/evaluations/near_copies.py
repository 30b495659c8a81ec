"""Finds evaluations that act nearly as an earlier submission of another team; for organizers, who decide.

Every completed evaluation leaves the first actions of its episodes, on each list that it plays, and is compared with
those of all other teams on the same list. Of two that are alike the later one is noted; a log of that kind is not
ranked, as one with equal states (`copies`).
"""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

import numpy as np
from sqlalchemy import delete, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, defer, joinedload
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.scoring.near_copies import TRACED_STEPS, Likeness, Trace, compare_traces, make_trace
from vitac.evaluator.submission_kinds import SubmissionKind

from ..db.models import ActionTrace, Evaluation, NearCopy, Submission
from ..principals import Principal
from ..views.evaluations import NearCopyView
from .copies import flag_log


@dataclass(frozen=True, kw_only=True)
class _Other:
    """An evaluation of the same list that acts alike, perhaps of the same team.

    Attributes:
        earlier: how alike they are, where it was submitted before.
        later: the same, where it was submitted afterwards.
    """

    evaluation: Evaluation
    earlier: Likeness
    later: Likeness

    @property
    def moment(self) -> tuple[datetime, UUID]:
        return _get_moment(self.evaluation.submission)


def note_near_copies(
    session: Session, evaluation: Evaluation, commitment: str, played: Mapping[str, Collection[EpisodeRecord]]
) -> None:
    """Store the actions of a completed evaluation on one list, and note what is alike of other teams.

    Args:
        session: of the transaction.
        evaluation: which was completed.
        commitment: of the sealed list; empty for the public one.
        played: all records there, by task.
    """
    for task, records in played.items():
        actions = [record.actions.to_array() for record in records]
        size = max((each.shape[1] for each in actions if each.size), default=0)
        if not size:
            continue
        trace = make_trace(actions, size)
        session.add(
            ActionTrace(
                evaluation_id=evaluation.id,
                task=task,
                commitment=commitment,
                action_size=size,
                actions=trace.tobytes(),
            )
        )
        _note(session, evaluation, task, commitment, list(_find_alike(session, evaluation, task, commitment, trace)))


def list_near_copies(session: Session, by: Principal, *, limit: int = 1000) -> list[NearCopyView]:
    """Return what was found, the newest first.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.contest)
    query = (
        select(NearCopy)
        .join(NearCopy.evaluation)
        .join(Evaluation.submission)
        .options(
            joinedload(NearCopy.evaluation).joinedload(Evaluation.submission).joinedload(Submission.team),
            joinedload(NearCopy.earlier_submission).joinedload(Submission.team),
        )
        .order_by(NearCopy.found_at.desc(), NearCopy.evaluation_id, NearCopy.task, NearCopy.commitment)
        .limit(limit)
    )
    if by.contest is not None:
        query = query.where(Submission.contest == by.contest)
    return [_view(found) for found in session.scalars(query)]


def _find_alike(session: Session, evaluation: Evaluation, task: str, commitment: str, trace: Trace) -> Iterator[_Other]:
    stored = session.execute(
        select(ActionTrace.actions, Evaluation)
        .join(Evaluation, Evaluation.id == ActionTrace.evaluation_id)
        .where(
            ActionTrace.task == task,
            ActionTrace.commitment == commitment,
            ActionTrace.action_size == trace.shape[2],
            Evaluation.id != evaluation.id,
        )
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission))
    )
    for content, other in stored:
        theirs = np.frombuffer(content, np.float32).reshape(-1, TRACED_STEPS, trace.shape[2])
        found = _Other(evaluation=other, earlier=compare_traces(theirs, trace), later=compare_traces(trace, theirs))
        if found.earlier.is_copy or found.later.is_copy:
            yield found


def _note(session: Session, evaluation: Evaluation, task: str, commitment: str, alike: Sequence[_Other]) -> None:
    """Note which is the copy: of the two teams the one that acted so first is nobody's copy."""
    by_team: dict[UUID, list[_Other]] = defaultdict(list)
    for other in alike:
        by_team[other.evaluation.submission.team_id].append(other)
    ours = by_team.pop(evaluation.submission.team_id, [])
    own_first = min([_get_moment(evaluation.submission), *(other.moment for other in ours)])
    for theirs in by_team.values():
        first = min(theirs, key=lambda other: other.moment)
        if first.moment < own_first:
            _add(session, evaluation, first.evaluation.submission_id, task, commitment, first.earlier)
            continue
        own = [evaluation.id, *(other.evaluation.id for other in ours)]
        session.execute(
            delete(NearCopy).where(
                NearCopy.evaluation_id.in_(own),
                NearCopy.earlier_submission_id.in_([other.evaluation.submission_id for other in theirs]),
            )
        )
        for other in theirs:
            _add(session, other.evaluation, own_first[1], task, commitment, other.later)


def _add(session: Session, later: Evaluation, earlier: UUID, task: str, commitment: str, likeness: Likeness) -> None:
    if not likeness.is_copy:
        return
    figures = {"near": likeness.near, "episodes": likeness.episodes, "difference": likeness.difference}
    session.execute(
        insert(NearCopy)
        .values(evaluation_id=later.id, earlier_submission_id=earlier, task=task, commitment=commitment, **figures)
        .on_conflict_do_update(constraint="pk_near_copies", set_=figures)
    )
    if later.submission.kind is SubmissionKind.LOG:
        flag_log(session, later, earlier, likeness.near)


def _get_moment(submission: Submission) -> tuple[datetime, UUID]:
    return submission.submitted_at, submission.id


def _view(found: NearCopy) -> NearCopyView:
    later, earlier = found.evaluation.submission, found.earlier_submission
    return NearCopyView(
        evaluation_id=found.evaluation_id,
        submission_id=later.id,
        submission_name=later.name,
        team=later.team.name,
        earlier_submission_id=earlier.id,
        earlier_submission_name=earlier.name,
        earlier_team=earlier.team.name,
        task=found.task,
        sealed=bool(found.commitment),
        near=found.near,
        episodes=found.episodes,
        difference=found.difference,
        found_at=found.found_at,
    )
