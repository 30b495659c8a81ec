"""Appeals: a team says that an evaluation went wrong, an organizer looks, plays episodes again beside it, and rules."""

from datetime import datetime, timedelta
from typing import Any
from uuid import UUID

from sqlalchemy import func, select
from sqlalchemy.orm import Session, joinedload, selectinload

from ..accounts import teams
from ..audit import record
from ..competitions.competition import Competition, find_stage
from ..database.clock import read_clock
from ..database.models import Appeal, EpisodeResult, Evaluation, Rejudgement, Submission
from ..database.states import TERMINAL_EVALUATION_STATES, AppealState, WorkState
from ..errors import ProblemCode, ServiceError, not_found
from ..evaluations.episode_store import EpisodeKey
from ..evaluations.history import newest_evaluation
from ..names import clean_text
from ..principals import Principal
from ..views.correspondence import AppealReplayView, AppealView
from ..visibility import changeable, decide_sight

MAX_OPEN = 3
MAX_A_DAY = 20
SHOWN = 200
_NO_RULING = "The competition became final before anybody ruled on this appeal."
_MAX_EPISODE = 1_000_000


def takes_appeals(session: Session, competition: str | None = None) -> bool:
    """Return whether a competition takes appeals; None: whether any of this service does."""
    asked = Competition.read_all(session) if competition is None else [Competition.read(session, competition)]
    return any(one.definition.appeal_days is not None and one.row.finalized_at is None for one in asked)


def open_appeal(
    session: Session,
    by: Principal,
    submission_id: UUID,
    text: str,
    *,
    task: str | None = None,
    episode: int | None = None,
) -> Appeal:
    """Appeal against the newest evaluation of a submission, within the time that the competition's file gives.

    Args:
        session: of the transaction.
        by: the team.
        submission_id: whose evaluation.
        text: what went wrong.
        task: in which task; None: in all.
        episode: in which episode of it; None: in all.

    Raises:
        ServiceError: there is no such submission or episode, its evaluation has not ended, the time is over, or there
            is an open appeal against it, or too many of the team.
    """
    submission = changeable(session, by, submission_id)
    kept = clean_text(text, what="An appeal")
    evaluation = newest_evaluation(session, submission)
    _require_time(session, evaluation)
    if task is not None or episode is not None:
        require_episode(session, evaluation, task, episode)
    teams.lock(session, submission.team)  # the second of two appeals at once sees the first one
    counted = select(func.count()).select_from(Appeal)
    is_open = Appeal.state == AppealState.OPEN
    if session.scalar(counted.where(is_open, Appeal.evaluation_id == evaluation.id)):
        raise ServiceError(ProblemCode.INVALID_REQUEST, "There is an open appeal against this evaluation already.")
    of_team, day = Appeal.team_id == submission.team_id, read_clock(session) - timedelta(days=1)
    waiting = session.scalar(counted.where(is_open, of_team)) or 0
    opened = session.scalar(counted.where(of_team, Appeal.opened_at > day)) or 0
    if waiting >= MAX_OPEN or opened >= MAX_A_DAY:
        raise ServiceError(
            ProblemCode.TOO_MANY_REQUESTS,
            f"A team may have {MAX_OPEN} open appeals and open {MAX_A_DAY} in a day; {submission.team.name} has "
            f"{waiting} open and has opened {opened}.",
        )
    made = Appeal(
        team_id=submission.team_id,
        evaluation_id=evaluation.id,
        task=task,
        episode=episode,
        text=kept,
        state=AppealState.OPEN,
        opened_at=read_clock(session),
    )
    session.add(made)
    session.flush()
    after = {"evaluation": str(evaluation.id), "task": task, "episode": episode}
    record(session, by, "appeal.open", f"appeal:{made.id}", after)
    return made


def withdraw(session: Session, by: Principal, appeal_id: int) -> None:
    """Withdraw an appeal of the own team.

    Raises:
        ServiceError: there is no such appeal, or it is ruled on.
    """
    appeal = find(session, by, appeal_id)
    if not by.may_change(appeal.team_id, appeal.evaluation.submission.competition):
        raise ServiceError(ProblemCode.FORBIDDEN, "A judge reads appeals only; ask an organizer.")
    _end(session, by, appeal, AppealState.WITHDRAWN, None)


def rule(session: Session, by: Principal, appeal_id: int, ruling: str, *, upheld: bool) -> Appeal:
    """Decide an appeal. It changes no result: to evaluate again, requeue the submission.

    Raises:
        ServiceError: not an organizer, there is no such appeal, it is decided already, or the text cannot be shown.
    """
    by.require_organizer(by.competition)
    appeal = find(session, by, appeal_id)
    kept = clean_text(ruling, what="A ruling")
    _end(session, by, appeal, AppealState.UPHELD if upheld else AppealState.REJECTED, kept)
    return appeal


def open_in_competition(session: Session, competition: Competition) -> list[Appeal]:
    """Return the appeals against results of a competition on which nobody has ruled, the first one first."""
    query = select(Appeal).join(Appeal.evaluation).join(Evaluation.submission).options(joinedload(Appeal.team))
    is_open = Appeal.state == AppealState.OPEN, competition.submissions
    return list(session.scalars(query.where(*is_open).order_by(Appeal.id)))


def end_with_competition(session: Session, by: Principal, competition: Competition) -> None:
    """Reject the appeals on which nobody has ruled when the competition becomes final.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(competition.name)
    for appeal in open_in_competition(session, competition):
        _end(session, by, appeal, AppealState.REJECTED, _NO_RULING)


def require_episode(session: Session, evaluation: Evaluation, task: str | None, episode: int | None) -> EpisodeResult:
    """Return a stored episode of an evaluation.

    Raises:
        ServiceError: it has no such episode, or only one of task and episode is given.
    """
    if task is None or episode is None:
        raise ServiceError(ProblemCode.INVALID_REQUEST, "Give both a task and an episode of it, or neither.")
    result = None
    if task.isprintable() and 0 < episode <= _MAX_EPISODE:
        key = EpisodeKey.from_evaluation(evaluation, evaluation.submission)
        wanted = EpisodeResult.task == task, EpisodeResult.episode == episode
        result = session.scalar(select(EpisodeResult).where(*key.conditions(), *wanted))
    if result is None:
        raise not_found("stored episode", f"{episode} of {task!r} of this evaluation")
    return result


def find(session: Session, by: Principal, appeal_id: int) -> Appeal:
    """Return an appeal, locked.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    appeal = session.get(Appeal, appeal_id, with_for_update={"of": Appeal}, populate_existing=True)
    if appeal is None or not by.may_see(appeal.team_id, appeal.evaluation.submission.competition):
        raise not_found("appeal", appeal_id)
    return appeal


def visible(
    session: Session, by: Principal, competition: str | None = None, *, open_only: bool = False
) -> list[AppealView]:
    """Return the newest appeals that somebody may see, newest first: those of the own team, or of all.

    Args:
        session: of the transaction.
        by: who asks.
        competition: name of the competition against whose results they are; None: all.
        open_only: leave out those that are decided or withdrawn.

    Raises:
        ServiceError: there is no competition of that name.
    """
    evaluation = joinedload(Appeal.evaluation)
    needed = (
        joinedload(Appeal.team),
        evaluation.joinedload(Evaluation.submission).joinedload(Submission.team),
        evaluation.joinedload(Evaluation.sealed_list),
        selectinload(Appeal.replays),
    )
    query = select(Appeal).options(*needed).order_by(Appeal.id.desc()).limit(SHOWN)
    asked = None if competition is None else Competition.find(session, competition).name
    for wanted in {by.competition, asked} - {None}:
        query = query.where(Appeal.evaluation.has(Evaluation.submission.has(Submission.competition == wanted)))
    if by.competition is None and not by.reads_all_teams:
        query = query.where(Appeal.team_id == by.team_id)
    if open_only:
        query = query.where(Appeal.state == AppealState.OPEN)
    return [appeal_view(one, by) for one in session.scalars(query)]


def appeal_view(appeal: Appeal, by: Principal) -> AppealView:
    """Return an appeal with what was played again, as far as its episodes are not sealed to who asks."""
    submission = appeal.evaluation.submission
    is_shown = decide_sight(by, appeal.evaluation).episodes
    replays = [one for one in appeal.replays if is_shown and one.state is WorkState.DONE]
    return AppealView.from_row(
        appeal,
        team=appeal.team.name,
        submission_id=submission.id,
        submission_name=submission.name,
        track=submission.track,
        replays=[AppealReplayView.model_validate(one, from_attributes=True) for one in replays],
    )


def _end(session: Session, by: Principal, appeal: Appeal, state: AppealState, ruling: str | None) -> None:
    if appeal.state is not AppealState.OPEN:
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"Appeal {appeal.id} is {appeal.state} already.")
    before: dict[str, Any] = {"state": appeal.state.value}
    appeal.state, appeal.ruling, appeal.ended_at = state, ruling, read_clock(session)
    after = {"state": state.value, "ruling": ruling}
    record(session, by, "appeal.rule" if ruling else "appeal.withdraw", f"appeal:{appeal.id}", after, before=before)


def _require_time(session: Session, evaluation: Evaluation) -> None:
    if evaluation.state not in TERMINAL_EVALUATION_STATES or evaluation.finished_at is None:
        raise ServiceError(ProblemCode.APPEAL_TOO_LATE, "This evaluation has not ended; wait for its result.")
    submission = evaluation.submission
    days = Competition.read(session, submission.competition or None).definition.appeal_days
    final = find_stage(session, submission).final_since
    if final is not None:
        raise ServiceError(
            ProblemCode.APPEAL_TOO_LATE,
            f"The results have been final since {final:%F %T} UTC, which ended appeals; you may ask a question.",
        )
    if days is None:
        raise ServiceError(ProblemCode.APPEAL_TOO_LATE, "This service takes no appeals; ask the organizers a question.")
    until = (_find_application(session, evaluation) or evaluation.finished_at) + timedelta(days=days)
    if read_clock(session) >= until:
        raise ServiceError(ProblemCode.APPEAL_TOO_LATE, f"Appeals were possible until {until:%F %T} UTC, {days} days.")


def _find_application(session: Session, evaluation: Evaluation) -> datetime | None:
    """Return when the rejudgement that made an evaluation was applied; until then nobody saw its result."""
    return session.scalar(select(Rejudgement.applied_at).where(Rejudgement.id == evaluation.rejudgement_id))
