"""Reads what waits for an organizer; called by the page of the desk."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from uuid import UUID

from sqlalchemy import ColumnElement, and_, exists, func, or_, select
from sqlalchemy.orm import Session, selectinload

from ..accounts import messages, teams
from ..audit import entry_view, newest_entries
from ..competitions.competition import Competition
from ..competitions.definition import StageRules
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import ArchiveCopy, EpisodeDifference, Evaluation, LogCopy, NearCopy, Qualification, Submission
from ..evaluations.drift import Drift, list_drifts
from ..evaluations.history import count_running
from ..evaluations.verdicts import ServiceVerdict
from ..principals import Principal
from ..submissions import appeals
from ..views.correspondence import AnnouncementView, AppealView, QuestionView
from ..views.teams import AuditEntryView, OrganizerTeamView

SHOWN = 20


@dataclass(frozen=True, kw_only=True)
class Trouble:
    """An evaluation that somebody has to look at.

    Attributes:
        problem: in words.
        at: when the evaluation was begun.
    """

    submission_id: UUID
    submission: str
    team: str
    track_title: str
    problem: str
    at: datetime


@dataclass(frozen=True, kw_only=True)
class StageState:
    """How far a stage is.

    Attributes:
        competition: name of the competition; None where there is a single one.
        address: name of the competition in addresses.
        competition_title: of the competition.
        qualified: number of teams that were confirmed; None: it is for all.
        submissions: made to it.
        running: evaluations that wait or run.
        over: whether it has closed.
    """

    competition: str | None
    address: str
    competition_title: str
    track: str
    track_title: str
    stage: StageRules
    qualified: int | None
    submissions: int
    running: int
    over: bool


def troubles(session: Session, by: Principal) -> list[Trouble]:
    """Return an organizer's newest evaluations that machines failed, that gave other results again, or are copies.

    Raises:
        ServiceError: forbidden.
    """
    by.require_organizer(by.competition)
    differs = exists().where(EpisodeDifference.evaluation_id == Evaluation.id)
    copied = and_(
        Submission.copy_cleared_at.is_(None),
        or_(
            exists().where(LogCopy.evaluation_id == Evaluation.id),
            exists().where(NearCopy.evaluation_id == Evaluation.id),
            exists().where(ArchiveCopy.submission_id == Submission.id),
        ),
    )
    failed = Evaluation.verdict_code == ServiceVerdict.MACHINE_FAILED.value
    rows = session.execute(
        select(Evaluation, failed, differs, copied)
        .join(Evaluation.submission)
        .where(or_(failed, differs, copied), *_own(by))
        .order_by(Evaluation.created_at.desc(), Evaluation.id)
        .limit(SHOWN)
        .options(selectinload(Evaluation.submission).selectinload(Submission.team))
    )
    return [
        Trouble(
            submission_id=evaluation.submission_id,
            submission=evaluation.submission.name,
            team=evaluation.submission.team.name,
            track_title=Competition.read(session, evaluation.submission.competition or None).track_title(
                evaluation.submission.track
            ),
            problem=_words(by_machines=by_machines, differing=differing, copy=copy),
            at=evaluation.created_at,
        )
        for evaluation, by_machines, differing, copy in rows
    ]


def stages(session: Session, by: Principal, at: datetime | None = None) -> Sequence[StageState]:
    """Return the stages of an organizer's competitions; `at` is the moment, None: now.

    Raises:
        ServiceError: forbidden.
    """
    by.require_organizer(by.competition)
    now, competitions = at or read_clock(session), Competition.read_all(session)
    return [
        StageState(
            competition=competition.name if len(competitions) > 1 else None,
            address=competition.name,
            competition_title=competition.definition.title,
            track=stage.track,
            track_title=stage.track_rules.title,
            stage=stage.rules,
            qualified=_count_qualified(session, stage) if stage.rules.qualified is not None else None,
            submissions=session.scalar(select(func.count()).select_from(Submission).where(stage.submissions)) or 0,
            running=count_running(session, stage),
            over=stage.is_over(now),
        )
        for competition in competitions
        if by.organizes(competition.name)
        for stage in competition.stages_held_here
    ]


def _own(by: Principal) -> tuple[ColumnElement[bool], ...]:
    """Return the condition that a submission belongs to the organizer's competition; none for the whole service."""
    return () if by.organizes_service else (Submission.competition == by.competition,)


def _words(*, by_machines: bool, differing: bool, copy: bool) -> str:
    causes = [
        words
        for words, holds in (
            ("the machines failed", by_machines),
            ("an episode gave another result when it was run again", differing),
            ("the states, nearly the actions, or the archive of another team's earlier submission", copy),
        )
        if holds
    ]
    return "; ".join(causes)


def _count_qualified(session: Session, stage: Stage) -> int:
    return session.scalar(select(func.count()).select_from(Qualification).where(stage.qualifications)) or 0


N_ENTRIES = 20


@dataclass(frozen=True, kw_only=True)
class Desk:
    """What organizers look at often; those of one competition see its submissions, appeals and stages.

    Attributes:
        waiting: teams that wait to be accepted.
        troubles: submissions that somebody has to look at.
        asked: questions without an answer.
        appealed: appeals without a ruling.
        stages: of the competition, with who may take part.
        drifts: of the teams in stages that one sealed list decides at once.
        said: announcements and messages that they may withdraw.
        entries: the last lines of the audit log.
    """

    troubles: Sequence[Trouble]
    appealed: Sequence[AppealView]
    stages: Sequence[StageState]
    drifts: Sequence[Drift] = ()
    waiting: Sequence[OrganizerTeamView] = ()
    asked: Sequence[QuestionView] = ()
    said: Sequence[AnnouncementView] = ()
    entries: Sequence[AuditEntryView] = ()


def read_desk(session: Session, by: Principal) -> Desk:
    """Return the desk of an organizer.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    of_own = Desk(
        troubles=troubles(session, by),
        appealed=appeals.visible(session, by, open_only=True),
        stages=stages(session, by),
        drifts=[
            drift
            for competition in Competition.read_all(session)
            if by.organizes(competition.name)
            for stage in competition.stages_held_here
            if stage.plays_fresh_lists
            for drift in list_drifts(session, stage)
        ],
        said=[
            one
            for one in messages.list_announcements(session, by)
            if by.organizes_service or one.competition == by.competition
        ],
    )
    if not by.organizes_service:
        return of_own
    return replace(
        of_own,
        waiting=[teams.organizer_team_view(session, team) for team in teams.waiting(session)],
        asked=messages.list_questions(session, by, open_only=True),
        entries=[entry_view(entry) for entry in newest_entries(session, N_ENTRIES)],
    )
