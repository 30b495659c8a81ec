"""The final list of a stage: which submissions play it, played once after the close, and what it changed.

The chosen submissions of all teams are entered together, as submissions to the final list, whose board decides.
"""

from collections.abc import Sequence
from itertools import groupby
from uuid import UUID

import structlog
from sqlalchemy import ColumnElement, insert, literal, select
from sqlalchemy.orm import Session
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks.registry import find_version

from ..accounts import teams
from ..audit import record
from ..competitions.competition import Competition, find_stage
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import ALL_TASKS, BoardResult, JudgingMark, SealedList, Submission, SubmissionFile, Team
from ..database.states import FileRole
from ..errors import ProblemCode, ServiceError
from ..evaluations import lifecycle
from ..evaluations.history import require_current, require_scored
from ..leaderboards.best_entries import takes_part
from ..principals import CONSOLE, Principal
from ..receipts.issuing import issue_for_submission
from ..transparency.entries import FinalListPlayed
from ..transparency.log import append
from ..visibility import changeable

logger = structlog.get_logger(__name__)

_OWN = frozenset({"id", "stage", "chosen_at", "final_of"})
"""What a submission to the final list does not take over from the chosen one."""


def choose(session: Session, by: Principal, submission_id: UUID, *, chosen: bool) -> None:
    """Let a submission play the final list of its stage, or no longer; of more than it takes the newest choices count.

    Args:
        session: of the transaction.
        by: its team until the stage closes, an organizer until the final list is played.
        submission_id: which one.
        chosen: whether it plays it.

    Raises:
        ServiceError: there is no such submission, it is no model of a stage with a final list, or it is too late.
    """
    submission = changeable(session, by, submission_id)
    teams.lock(session, submission.team)
    final = _find_final(session, find_stage(session, submission))
    _require_in_time(session, by, final)
    if not submission.kind.form.runs_policy:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"Expected a model, got a {submission.kind}: only models play {final}.",
        )
    if (submission.chosen_at is not None) == chosen:
        return
    before = {"chosen": not chosen}
    submission.chosen_at = read_clock(session) if chosen else None
    record(session, by, "submission.choose", f"submission:{submission.id}", {"chosen": chosen}, before=before)
    session.flush()
    if chosen and final.live is not None:
        _drop_oldest(session, submission, final.live)


def play(session: Session, by: Principal, stage: Stage) -> Sequence[UUID]:
    """Enter the chosen submissions of all teams into the final list of a stage; once. Return the new submissions.

    Args:
        session: of the transaction.
        by: an organizer.
        stage: with a final list.

    Raises:
        ServiceError: not an organizer, there is no final list, it was played, the competition is final, or the stage is
            not over, scored and of today's evaluator.
    """
    by.require_organizer(stage.competition)
    competition = Competition.lock(session, stage.competition)
    competition.require_not_final()
    final = _find_final(session, stage)
    sealed = session.scalar(
        select(SealedList)
        .where(*final.make_rows(SealedList), SealedList.withdrawn_at.is_(None))
        .execution_options(populate_existing=True)
    )
    if sealed is None:
        raise ServiceError(ProblemCode.LIST_SEALED, f"Expected a secret for {final}, got none; apply the file again.")
    if sealed.played_at is not None:
        raise ServiceError(
            ProblemCode.STAGE_IN_USE, f"Expected {final} to be played once; it was, at {sealed.played_at:%F %T} UTC."
        )
    stage.require_over()
    require_scored(session, stage)
    require_current(session, stage)
    sealed.played_at = read_clock(session)
    chosen = _list_chosen(session, stage)
    entered = [_enter(session, submission, final) for submission in chosen]
    after = {"submissions": [str(submission.id) for submission in chosen]}
    record(session, by, "stage.play_final", final.subject, after)
    for submission in entered:  # Receipts come last: the lock of the log locks out all others.
        issue_for_submission(session, submission)
    append(
        session,
        lambda at: FinalListPlayed(
            **final.place,
            issued_at=at,
            submissions=tuple(submission.id for submission in chosen),
        ),
    )
    return [submission.id for submission in entered]


def play_due(session: Session) -> int:
    """Play each final list whose stage is over and scored; return how many. The others wait for a later call."""
    played, now = 0, read_clock(session)
    for competition in Competition.read_all(session):
        for stage in competition.stages_held_here if competition.row.finalized_at is None else ():
            if stage.live is None or stage.sealed_list is None or stage.played_since or not stage.is_over(now):
                continue
            try:
                with session.begin_nested():
                    play(session, CONSOLE, stage.live)
            except ServiceError as error:
                logger.info("final_list_waits", stage=stage.subject, reason=error.detail)
            else:
                played += 1
    return played


def _find_final(session: Session, stage: Stage) -> Stage:
    competition = Competition.read(session, stage.competition)
    final = next((one for one in competition.stages_held_here if one.live == stage), None)
    if final is None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected a stage with a final list (`sealed: live_and_final`), got {stage}, which plays none.",
        )
    return final


def _require_in_time(session: Session, by: Principal, final: Stage) -> None:
    if final.played_since is not None:
        raise ServiceError(ProblemCode.STAGE_CLOSED, f"{final} is played since {final.played_since:%F %T} UTC.")
    if final.is_over(read_clock(session)) and not by.organizes(final.competition):
        raise ServiceError(
            ProblemCode.STAGE_CLOSED, f"Teams chose until the stage closed, at {final.rules.closes:%F %T} UTC."
        )


def _drop_oldest(session: Session, submission: Submission, stage: Stage) -> None:
    """Take back the oldest choices of a team that are more than the final list takes."""
    of_team = stage.submissions, Submission.team_id == submission.team_id, Submission.chosen_at.is_not(None)
    newest_first = select(Submission).where(*of_team).order_by(Submission.chosen_at.desc(), Submission.id)
    for other in session.scalars(newest_first.offset(stage.rules.final_submissions)):
        other.chosen_at = None


def _list_chosen(session: Session, stage: Stage) -> list[Submission]:
    """Return of each team what it chose, and else its best: ranked models of the live list."""
    ranked = session.scalars(
        select(Submission)
        .join(BoardResult, BoardResult.submission_id == Submission.id)
        .join(Team, Team.id == Submission.team_id)
        .where(
            stage.submissions,
            BoardResult.board == ALL_TASKS,
            BoardResult.kind == SubmissionKind.MODEL,
            BoardResult.evaluator_version == find_version(stage.track),
            ~BoardResult.is_copy,
            ~BoardResult.is_off_boards,
            takes_part(),
        )
        .order_by(Submission.team_id, Submission.chosen_at.desc().nulls_last(), BoardResult.sort_key, Submission.id)
    )
    return [
        submission
        for _, of_team in groupby(ranked, key=lambda submission: submission.team_id)
        for submission in list(dict.fromkeys(of_team))[: stage.rules.final_submissions]
    ]


def _enter(session: Session, chosen: Submission, final: Stage) -> Submission:
    """Make the submission that plays the final list, with the sensor, document and marks of the chosen one."""
    columns = set(Submission.__mapper__.column_attrs.keys()) - _OWN
    entered = Submission(
        **{name: getattr(chosen, name) for name in columns}, stage=final.name, final_of=chosen.id, team=chosen.team
    )
    session.add(entered)
    session.flush()
    of_chosen = SubmissionFile.submission_id == chosen.id
    _copy_rows(
        session, entered, SubmissionFile, of_chosen, SubmissionFile.role.in_((FileRole.SENSOR, FileRole.DOCUMENT))
    )
    _copy_rows(session, entered, JudgingMark, JudgingMark.submission_id == chosen.id)
    lifecycle.start(session, entered, run=1)
    return entered


def _copy_rows(
    session: Session,
    to: Submission,
    table: type[SubmissionFile] | type[JudgingMark],
    *conditions: ColumnElement[bool],
) -> None:
    names = [name for name in table.__mapper__.column_attrs.keys() if name != "submission_id"]  # noqa: SIM118 - no mapping
    rows = select(literal(to.id), *(getattr(table, name) for name in names)).where(*conditions)
    session.execute(insert(table).from_select(["submission_id", *names], rows))
