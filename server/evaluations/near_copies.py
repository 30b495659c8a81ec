"""Finds evaluations that are near copies of another team's earlier submission; called when an evaluation is complete.

Every one leaves the first actions of its episodes and the states on their way, on each list that it plays, and is
compared with those of all other teams on the same list. Of two that are alike the later one is noted, and not ranked in
that task until an organizer clears it, as a log with equal states (`copies`).
"""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, delete, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, defer, joinedload, undefer
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.scoring.near_copies import Likeness, Trace, compare_traces, make_trace
from vitac.evaluator.submission.likeness import ArchiveLikeness, ArchiveSketch, compare_sketches

from ..database.models import ActionTrace, ArchiveCopy, Evaluation, NearCopy, Submission
from ..principals import Principal
from ..views.evaluations import ArchiveCopyView, NearCopyView
from .copies import mark_copy

SHOWN = 1000
"""Findings that organizers see at once."""


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
    session: Session, evaluation: Evaluation, played: Mapping[str, Mapping[str, Collection[EpisodeRecord]]]
) -> None:
    """Store what a completed evaluation is compared by, and note what is alike of other teams.

    Args:
        session: of the transaction.
        evaluation: which was completed.
        played: all records by list and task; a list is the commitment of the sealed one, or empty for the public one.
    """
    for commitment, by_task in played.items():
        for task, records in by_task.items():
            _note_list(session, evaluation, task, commitment, records)


def _note_list(
    session: Session, evaluation: Evaluation, task: str, commitment: str, records: Collection[EpisodeRecord]
) -> None:
    if records:
        actions = [record.actions.to_array() for record in records]
        size = max((each.shape[1] for each in actions if each.size), default=0)
        if not size:
            return
        trace = make_trace(actions, size, [record.infos for record in records])
        session.add(
            ActionTrace(
                evaluation_id=evaluation.id,
                task=task,
                commitment=commitment,
                action_size=size,
                actions=trace.actions.tobytes(),
                paths=trace.paths.tobytes(),
            )
        )
        _note(session, evaluation, task, commitment, list(_find_alike(session, evaluation, task, commitment, trace)))


def list_near_copies(session: Session, by: Principal) -> list[NearCopyView]:
    """Return what was found, the newest first.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    query = (
        select(NearCopy)
        .join(NearCopy.evaluation)
        .join(Evaluation.submission)
        .options(
            joinedload(NearCopy.evaluation).joinedload(Evaluation.submission).joinedload(Submission.team),
            joinedload(NearCopy.earlier_submission).joinedload(Submission.team),
        )
        .order_by(NearCopy.found_at.desc(), NearCopy.evaluation_id, NearCopy.task, NearCopy.commitment)
        .limit(SHOWN)
    )
    if by.competition is not None:
        query = query.where(Submission.competition == by.competition)
    return [_view(near) for near in session.scalars(query)]


def _find_alike(session: Session, evaluation: Evaluation, task: str, commitment: str, trace: Trace) -> Iterator[_Other]:
    stored = session.execute(
        select(ActionTrace.actions, ActionTrace.paths, Evaluation)
        .join(Evaluation, Evaluation.id == ActionTrace.evaluation_id)
        .where(
            ActionTrace.task == task,
            ActionTrace.commitment == commitment,
            ActionTrace.action_size == trace.actions.shape[2],
            Evaluation.id != evaluation.id,
        )
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission))
    )
    for actions, paths, other in stored:
        theirs = Trace(
            actions=np.frombuffer(actions, np.float32).reshape(-1, *trace.actions.shape[1:]),
            paths=_read_paths(paths, trace.paths.shape[1:]),
        )
        compared = _Other(evaluation=other, earlier=compare_traces(theirs, trace), later=compare_traces(trace, theirs))
        if compared.earlier.is_copy or compared.later.is_copy:
            yield compared


def _note(session: Session, evaluation: Evaluation, task: str, commitment: str, alike: Sequence[_Other]) -> None:
    """Note which is the copy: of the two teams the one that acted so first is nobody's copy."""
    by_team: dict[UUID, list[_Other]] = defaultdict(list)
    for other in alike:
        by_team[other.evaluation.submission.team_id].append(other)
    ours = by_team.pop(evaluation.submission.team_id, [])
    own_first = min([_get_moment(evaluation.submission), *(other.moment for other in ours)])
    own = {evaluation.id: evaluation} | {other.evaluation.id: other.evaluation for other in ours}
    for theirs in by_team.values():
        first = min(theirs, key=lambda other: other.moment)
        if first.moment < own_first:
            _add(session, evaluation, first.evaluation.submission_id, task, commitment, first.earlier)
            continue
        session.execute(
            delete(NearCopy).where(
                NearCopy.evaluation_id.in_(own),
                NearCopy.earlier_submission_id.in_([other.evaluation.submission_id for other in theirs]),
            )
        )
        for one in own.values():
            mark_copy(session, one)
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
    mark_copy(session, later)


def _get_moment(submission: Submission) -> tuple[datetime, UUID]:
    return submission.submitted_at, submission.id


def _read_paths(content: bytes, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return stored paths whose states have as many numbers as ours; none of other ones."""
    numbers = np.frombuffer(content, np.float32)
    size = int(np.prod(shape))
    return numbers.reshape(-1, *shape) if size and numbers.size % size == 0 else np.zeros((0, *shape), np.float32)


def _view(near: NearCopy) -> NearCopyView:
    later, earlier = near.evaluation.submission, near.earlier_submission
    return NearCopyView(
        evaluation_id=near.evaluation_id,
        submission_id=later.id,
        submission_name=later.name,
        team=later.team.name,
        earlier_submission_id=earlier.id,
        earlier_submission_name=earlier.name,
        earlier_team=earlier.team.name,
        task=near.task,
        sealed=bool(near.commitment),
        near=near.near,
        episodes=near.episodes,
        difference=near.difference,
        found_at=near.found_at,
    )


def note_archive_copies(session: Session, submission: Submission) -> None:
    """Compare a model with those that other teams have submitted to its track, and note of which it may be a copy.

    A submission that is alike to what its team had before is nobody's copy.
    """
    later_than_ours = Submission.submitted_at > submission.submitted_at
    ours = list(_find_alike_archives(session, submission, Submission.team_id == submission.team_id, ~later_than_ours))
    first = min([submission.submitted_at, *(own.submitted_at for own, _ in ours)])
    others = Submission.team_id != submission.team_id, Submission.submitted_at < first
    for earlier, likeness in _find_alike_archives(session, submission, *others):
        figures = {"code": likeness.code, "weights": likeness.weights}
        session.execute(
            insert(ArchiveCopy)
            .values(submission_id=submission.id, earlier_submission_id=earlier.id, **figures)
            .on_conflict_do_update(constraint="pk_archive_copies", set_=figures)
        )


def list_archive_copies(session: Session, by: Principal) -> list[ArchiveCopyView]:
    """Return what was found, the newest first.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    query = (
        select(ArchiveCopy)
        .join(Submission, Submission.id == ArchiveCopy.submission_id)
        .options(
            joinedload(ArchiveCopy.submission).joinedload(Submission.team),
            joinedload(ArchiveCopy.earlier_submission).joinedload(Submission.team),
        )
        .order_by(ArchiveCopy.found_at.desc(), ArchiveCopy.submission_id, ArchiveCopy.earlier_submission_id)
        .limit(SHOWN)
    )
    if by.competition is not None:
        query = query.where(Submission.competition == by.competition)
    return [
        ArchiveCopyView.from_row(
            copy,
            submission_name=copy.submission.name,
            team=copy.submission.team.name,
            earlier_submission_name=copy.earlier_submission.name,
            earlier_team=copy.earlier_submission.team.name,
            track=copy.submission.track,
        )
        for copy in session.scalars(query)
    ]


def compare_archives(session: Session, by: Principal, copies: Collection[NearCopyView]) -> list[NearCopyView]:
    """Return near copies with how alike the archives are, where both are models.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    asked = {id_ for one in copies for id_ in (one.submission_id, one.earlier_submission_id)}
    rows = session.execute(
        select(Submission.id, Submission.archive_sketch).where(
            Submission.id.in_(asked), Submission.archive_sketch.is_not(None)
        )
    )
    sketches = {row.id: ArchiveSketch.from_bytes(row.archive_sketch) for row in rows}
    return [_compared(one, sketches.get(one.earlier_submission_id), sketches.get(one.submission_id)) for one in copies]


def _compared(near: NearCopyView, earlier: ArchiveSketch | None, later: ArchiveSketch | None) -> NearCopyView:
    if earlier is None or later is None:
        return near
    alike = compare_sketches(earlier, later)
    return near.model_copy(update={"code": alike.code, "weights": alike.weights})


def _find_alike_archives(
    session: Session, submission: Submission, *conditions: ColumnElement[bool]
) -> Iterator[tuple[Submission, ArchiveLikeness]]:
    if submission.archive_sketch is None:
        return
    ours = ArchiveSketch.from_bytes(submission.archive_sketch)
    others = session.scalars(
        select(Submission)
        .where(
            Submission.track == submission.track,
            Submission.id != submission.id,
            Submission.archive_sketch.is_not(None),
            *conditions,
        )
        .options(undefer(Submission.archive_sketch))
        .execution_options(yield_per=200)
    )
    for other in others:
        assert other.archive_sketch is not None  # noqa: S101 - as the query says
        likeness = compare_sketches(ArchiveSketch.from_bytes(other.archive_sketch), ours)
        if likeness.is_copy:
            yield other, likeness
