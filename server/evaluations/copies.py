"""Finds logs whose states another team reached before; called when an evaluation is complete.

Re-simulation proves the actions of a log, not whose they are: whoever has a log can upload it under another header, and
changes of the actions that move nothing (-0.0 for 0.0) change its digest. Equal states show it all the same; those
half-way through an episode do so where its last actions are other ones.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cache, partial
from typing import Any
from uuid import UUID

from sqlalchemy import ScalarSelect, Select, bindparam, case, delete, func, or_, over, select, tuple_, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import InstrumentedAttribute, Session, aliased
from vitac.evaluator.episodes.records import ActionSequence
from vitac.evaluator.submission_kinds import SubmissionKind

from ..accounts.shown_names import ShownNames
from ..database.engine import among_parameter
from ..database.models import ALL_TASKS, BoardResult, EpisodeResult, Evaluation, LogCopy, NearCopy, Submission, Team
from ..database.states import EvaluationState
from ..views.evaluations import CopyView
from .episode_store import EpisodeKey


@dataclass(frozen=True, kw_only=True)
class _Twin:
    """A submission of another team that shares states, where the later of both is the first of its team with them.

    Attributes:
        whole: ids of our episodes of which it has all states.
        begun: ids of our episodes of which it has the state half-way, and other ones at the end.
    """

    submission_id: UUID
    kind: SubmissionKind
    submitted_at: datetime
    whole: Collection[int]
    begun: Collection[int]

    @property
    def moment(self) -> tuple[datetime, UUID]:
        return self.submitted_at, self.submission_id


def flag_copies(session: Session, evaluation: Evaluation) -> None:
    """Compare a completed evaluation with the episodes of all other teams; of a log and its twin the later is flagged.

    Either may be evaluated first. With half of its episodes or more a log is a copy, and not ranked. An episode whose
    states its team had before the other one is nobody's copy.
    """
    _compare(session, evaluation)
    for own in _flagged_before_ours_was_known(session, evaluation.submission):
        session.execute(delete(LogCopy).where(LogCopy.evaluation_id == own.id))
        mark_copy(session, own)
        _compare(session, own)


def _flagged_before_ours_was_known(session: Session, submission: Submission) -> Collection[Evaluation]:
    """Return the team's evaluations that were flagged for a submission after this one."""
    theirs, own = aliased(Submission), aliased(Submission)
    return session.scalars(
        select(Evaluation)
        .join(own, Evaluation.submission)
        .join(LogCopy, LogCopy.evaluation_id == Evaluation.id)
        .join(theirs, theirs.id == LogCopy.earlier_submission_id)
        .where(
            own.team_id == submission.team_id,
            tuple_(theirs.submitted_at, theirs.id) > tuple_(submission.submitted_at, submission.id),
        )
        .order_by(Evaluation.id)
    ).all()


def _compare(session: Session, evaluation: Evaluation) -> None:
    submission = evaluation.submission
    moment = (submission.submitted_at, submission.id)
    is_log = submission.kind.form.is_verified
    twins = _twins(session, evaluation)
    earlier = [twin for twin in twins if is_log and twin.moment < moment]
    later = [twin for twin in twins if twin.kind.form.is_verified and twin.moment > moment]
    begun = _beginnings(session, {episode for twin in (*earlier, *later) for episode in twin.begun})
    if earlier:
        closest = max(earlier, key=lambda twin: _count(twin, begun))
        _flag(session, [evaluation], closest.submission_id, _count(closest, begun))
    for twin in later:
        _flag(session, list_completed(session, twin.submission_id), submission.id, _count(twin, begun))


def _count(twin: _Twin, begun: Mapping[int, bytes]) -> int:
    """Return how many episodes are equal; of those that only begin equally, each row of actions counts once.

    Policies that begin every episode with the same moves, to feel what they hold, reach the same states by themselves.
    """
    return len(twin.whole) + len({begun[episode] for episode in twin.begun})


def _beginnings(session: Session, episodes: Collection[int]) -> dict[int, bytes]:
    """Return the actions of the first half of some episodes, -0.0 as 0.0."""
    if not episodes:
        return {}
    rows = session.execute(
        select(EpisodeResult.id, EpisodeResult.record["actions"]).where(EpisodeResult.id.in_(episodes))
    )
    actions = {episode: ActionSequence.model_validate(beginning).to_array() for episode, beginning in rows}
    return {episode: (beginning[: (len(beginning) + 1) // 2] + 0.0).tobytes() for episode, beginning in actions.items()}


def mark_copy(session: Session, evaluation: Evaluation) -> None:
    """Take a copy off its boards; put back what is none, or what an organizer has cleared.

    A log is a copy if half of its episodes or more are; a model in the tasks in which it is near another one.
    """
    boards = set() if evaluation.submission.copy_cleared_at is not None else _boards_of_copy(session, evaluation)
    session.execute(
        update(BoardResult)
        .where(BoardResult.evaluation_id == evaluation.id)
        .values(is_copy=BoardResult.board.in_(boards))
    )


def _boards_of_copy(session: Session, evaluation: Evaluation) -> set[str]:
    """Return the boards on which an evaluation is a copy."""
    equal = session.scalar(select(LogCopy.episodes).where(LogCopy.evaluation_id == evaluation.id)) or 0
    near = set(session.scalars(select(NearCopy.task).where(NearCopy.evaluation_id == evaluation.id)))
    if equal and 2 * equal >= sum(score["episodes"] for score in evaluation.scores or []):
        near |= set(evaluation.submission.tasks)
    return near | {ALL_TASKS} if near else near


def find_copies(
    session: Session, evaluations: Collection[UUID], names: ShownNames, *, logs: Collection[UUID]
) -> dict[UUID, CopyView]:
    """Return what was found of these evaluations, with the teams under the names that are shown.

    Only `logs`, those of them that are evaluations of logs, are looked for among those with equal states.

    Equal states of a log say more than near ones; of several near ones the one with most episodes is shown.
    """
    if not evaluations:
        return {}
    copies = {
        near.evaluation_id: CopyView(
            team=names.show_name(team),
            episodes=near.near,
            of=near.episodes,
            task=near.task,
            sealed=bool(near.commitment),
            ranked=not is_copy,
            cleared_for=cleared_for,
        )
        for near, team, is_copy, cleared_for in session.execute(
            _near_copies_with_teams(), {"evaluations": list(evaluations)}
        )
    }
    if not logs:
        return copies
    return copies | {
        evaluation_id: CopyView(
            team=names.show_name(team), episodes=episodes, ranked=not is_copy, cleared_for=cleared_for
        )
        for evaluation_id, team, episodes, is_copy, cleared_for in session.execute(
            _copies_with_teams(), {"evaluations": list(logs)}
        )
    }


@cache
def _copies_with_teams() -> Select[UUID, Team, int, bool, str | None]:
    """Return the query of the logs with equal states among `evaluations`, put together once: most pages ask it."""
    earlier, copy = aliased(Submission), LogCopy.evaluation_id
    return (
        select(copy, Team, LogCopy.episodes, _is_copy(copy), _cleared_for(copy))
        .join(earlier, earlier.id == LogCopy.earlier_submission_id)
        .join(Team, Team.id == earlier.team_id)
        .where(among_parameter(LogCopy.evaluation_id, "evaluations"))
    )


@cache
def _near_copies_with_teams() -> Select[NearCopy, Team, bool, str | None]:
    """Return the query of the near copies among `evaluations`, that with most episodes last."""
    earlier, copy = aliased(Submission), NearCopy.evaluation_id
    return (
        select(NearCopy, Team, _is_copy(copy), _cleared_for(copy))
        .join(earlier, earlier.id == NearCopy.earlier_submission_id)
        .join(Team, Team.id == earlier.team_id)
        .where(among_parameter(NearCopy.evaluation_id, "evaluations"))
        .order_by(NearCopy.near, NearCopy.earlier_submission_id, NearCopy.task, NearCopy.commitment)
    )


def _is_copy(evaluation_id: InstrumentedAttribute[UUID]) -> ScalarSelect[bool]:
    marked = func.coalesce(func.bool_or(BoardResult.is_copy), False)
    return select(marked).where(BoardResult.evaluation_id == evaluation_id).scalar_subquery()


def _cleared_for(evaluation_id: InstrumentedAttribute[UUID]) -> ScalarSelect[str | None]:
    cleared = select(Submission.copy_cleared_for).join(Evaluation, Evaluation.submission_id == Submission.id)
    return cleared.where(Evaluation.id == evaluation_id).scalar_subquery()


def count_copied_episodes() -> ScalarSelect[int]:
    """Return how many episodes of a row of `evaluations` have the states of an earlier log, for a query on them."""
    largest = select(func.max(LogCopy.episodes)).where(LogCopy.evaluation_id == Evaluation.id)
    return select(func.coalesce(largest.correlate(Evaluation).scalar_subquery(), 0)).scalar_subquery()


def _twins(session: Session, evaluation: Evaluation) -> list[_Twin]:
    """Return the submissions of other teams that share states; of equal ones the earliest first."""
    submission = evaluation.submission
    ours = {"own_team": submission.team_id, "own_moment": submission.submitted_at, "own_id": submission.id}
    rows = session.execute(_select_twins(), EpisodeKey.from_evaluation(evaluation, submission).given() | ours)
    return [
        _Twin(submission_id=submission_id, kind=kind, submitted_at=submitted_at, whole=whole, begun=begun)
        for submission_id, kind, submitted_at, whole, begun in rows
    ]


@cache
def _select_twins() -> Select[Any]:
    """Return the query of `_twins`, put together once: that takes as long as running it."""
    states = _select_first_with_states().cte("found")
    own = (
        select(states.c.episode, states.c.first_at, states.c.first_id)
        .where(states.c.team_id == bindparam("own_team"))
        .distinct()
        .subquery()
    )
    own_moment = bindparam("own_moment", type_=states.c.first_at.type)
    own_id = bindparam("own_id", type_=states.c.first_id.type)
    return (
        select(
            states.c.submission_id,
            states.c.kind,
            states.c.submitted_at,
            func.array_remove(func.array_agg(case((states.c.whole, states.c.episode))), None),
            func.array_remove(func.array_agg(case((~states.c.whole, states.c.episode))), None),
        )
        .join(own, own.c.episode == states.c.episode)
        .where(
            states.c.team_id != bindparam("own_team"),
            or_(
                tuple_(states.c.submitted_at, states.c.submission_id) < tuple_(own.c.first_at, own.c.first_id),
                tuple_(states.c.first_at, states.c.first_id) > tuple_(own_moment, own_id),
            ),
        )
        .group_by(states.c.submission_id, states.c.kind, states.c.submitted_at)
        .order_by(states.c.submitted_at, states.c.submission_id)
    )


def _select_first_with_states() -> Select[Any]:
    """Return the episodes of a key with each submission that has their state half-way, and its team's first of them."""
    ours, theirs = aliased(EpisodeResult), aliased(EpisodeResult)
    sharing = (
        select(
            ours.id.label("episode"),
            Submission.id.label("submission_id"),
            Submission.team_id,
            Submission.kind,
            Submission.submitted_at,
            func.bool_or(theirs.states_digest == ours.states_digest).label("whole"),
        )
        .select_from(ours)
        # Under any number and track: repeats of a start, and tracks that differ in cameras only, have equal states.
        .join(theirs, theirs.half_way_state == ours.half_way_state)
        .join(Submission, Submission.digest == theirs.submission_digest)
        # Without an env step there are only the states of the reset, which are everybody's.
        .where(*EpisodeKey.conditions_given(ours), ours.env_steps > 0)
        .group_by(ours.id, Submission.id)
        .subquery()
    )
    of_team = partial(
        over,
        partition_by=(sharing.c.episode, sharing.c.team_id),
        order_by=(sharing.c.submitted_at, sharing.c.submission_id),
    )
    return select(
        sharing,
        of_team(func.first_value(sharing.c.submitted_at)).label("first_at"),
        of_team(func.first_value(sharing.c.submission_id)).label("first_id"),
    )


def list_completed(session: Session, submission_id: UUID) -> Collection[Evaluation]:
    """Return the completed evaluations of a submission."""
    return session.scalars(
        select(Evaluation)
        .where(Evaluation.submission_id == submission_id, Evaluation.state == EvaluationState.COMPLETED)
        .order_by(Evaluation.id)
    ).all()


def _flag(session: Session, evaluations: Collection[Evaluation], earlier: UUID, episodes: int) -> None:
    for evaluation in evaluations:
        new = insert(LogCopy).values(evaluation_id=evaluation.id, earlier_submission_id=earlier, episodes=episodes)
        session.execute(
            new.on_conflict_do_update(
                constraint="pk_log_copies",
                set_={"earlier_submission_id": new.excluded.earlier_submission_id, "episodes": new.excluded.episodes},
                where=new.excluded.episodes > LogCopy.episodes,
            )
        )
        mark_copy(session, evaluation)
