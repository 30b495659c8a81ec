"""Makes submissions out of checked uploads, in one transaction with their evaluation and its jobs."""

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session
from vitac.evaluator.isolation_kinds import IsolationKind

from ..accounts import teams
from ..accounts.outbox import announce_evaluation
from ..accounts.quotas import charge, check, check_stage
from ..audit import record
from ..competitions.competition import Competition, choose_competition
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import Submission, Team
from ..database.states import NoticeKind, Quota
from ..database.stored_uploads import HAS_NO_UPLOAD
from ..errors import ProblemCode, ServiceError
from ..evaluations import lifecycle
from ..principals import Principal
from ..receipts.issuing import issue_for_submission
from ..settings import Quotas
from .files import add_files
from .intake import AnnouncedUpload, CheckedUpload, check_file_name
from .runs import next_run, require_machines_hold
from .withdrawal import require_qualified, take_back

EVALUATION_QUOTAS = (Quota.QUEUED_AT_ONCE, Quota.ATTEMPTS_PER_DAY, Quota.SCORED_RUNS_PER_DAY, Quota.STORED_MIB)
DEFAULT_QUOTAS = Quotas()


def create(
    session: Session,
    by: Principal,
    upload: CheckedUpload,
    *,
    team: str | None = None,
    again: bool = False,
    competition: str | None = None,
    quotas: Quotas = DEFAULT_QUOTAS,
    at: datetime | None = None,
) -> tuple[Submission, bool]:
    """Make the submission and its evaluation, or find the one that exists; whether a new evaluation was started.

    The same content of the same team is one submission. While its evaluation is active or completed nothing new is
    started, unless `again` asks for a run that uses no stored episodes; after a cancel the run is taken up where it
    ended, after a failure a new run begins. The sensor made of the upload is stored with its run: whatever
    another mesher would make of the same content, a run that is active or completed keeps the one it is scored with.

    Args:
        session: of the transaction.
        by: who asks.
        upload: the checked body.
        team: for an organizer: whose submission it becomes.
        again: run all episodes again.
        competition: name of the competition; None: the one that takes submissions to the track.
        quotas: of teams without limits of their own.
        at: when it is complete; None: now.

    Raises:
        ServiceError: an organizer named no team, several competitions take the submission and none is named, the stage
            takes nothing (more) of the team, the file is named for another team, track or stage, the team has used one
            of its quotas, or machines have failed at the submission too often.
    """
    team_row = owner(session, by, team)
    teams.lock(session, team_row)
    teams.require_taking_part(team_row)
    now = at or read_clock(session)
    stage = choose_competition(session, upload.track, now, competition).open_stage(upload.track, by, now)
    stage.require_accepts(team_row, upload.kind)
    check_file_name(upload.file_name, team=team_row.name, stage=stage)
    submission, is_new = _find_or_add(session, team_row, upload, stage)
    require_qualified(submission)
    _require_gpu_fits(submission, stage)
    was_deleted = submission.erased_at is not None
    if session.scalar(select(HAS_NO_UPLOAD).where(Submission.id == submission.id)):
        # Its archive is gone or goes soon; this one holds the same content, however it is packed.
        submission.archive_sha256, submission.archive_bytes = upload.archive_sha256, upload.archive_bytes
    take_back(session, by, submission)
    run = next_run(session, submission, again=again)
    if run is None:
        if was_deleted:
            add_files(session, submission.id, upload.files)
        return submission, False
    add_files(session, submission.id, upload.files)
    require_machines_hold(session, by, submission)
    charged_at = charge(session, quotas, by, team_row, *EVALUATION_QUOTAS)
    check_stage(session, by, team_row, stage)
    evaluation = lifecycle.start(session, submission, run, charged_at=charged_at, makes_sensor=True)
    record(session, by, "submission.evaluate", f"submission:{submission.id}", {"run": run, "digest": upload.digest})
    announce_evaluation(session, NoticeKind.ACCEPTED, evaluation)
    if is_new:
        issue_for_submission(session, submission)
    return submission, True


def _require_gpu_fits(submission: Submission, stage: Stage) -> None:
    if submission.needs_gpu and stage.rules.isolation is IsolationKind.VM:
        raise ServiceError(
            ProblemCode.MANIFEST_REJECTED,
            f"submission.yaml says `needs: gpu`, but stage {stage.name} plays with isolation {IsolationKind.VM}, which "
            "has none; leave it out.",
        )


def expect_upload(session: Session, quotas: Quotas, by: Principal, announced: AnnouncedUpload) -> Team:
    """Return the team whose submission an upload becomes, before any of it is sent.

    What the team has submitted before, by the digest that the client says, may cost nothing.

    Raises:
        ServiceError: an organizer named no team, or none that exists, several competitions take submissions to the
            track and none is named, or the team has used one of its quotas.
    """
    team = owner(session, by, announced.team)
    if announced.track is not None:
        choose_competition(session, announced.track, read_clock(session), announced.competition)
    elif announced.competition is not None:
        Competition.find(session, announced.competition)
    same = Submission.team_id == team.id, Submission.archive_sha256 == announced.sha256
    if announced.sha256 is None or session.scalar(select(Submission.id).where(*same).limit(1)) is None:
        check(session, quotas, by, team, *EVALUATION_QUOTAS)
    return team


def owner(session: Session, by: Principal, team: str | None) -> Team:
    """Return the team whose submission an upload becomes.

    Raises:
        ServiceError: an organizer named no team, or none that exists.
    """
    if by.organizes_any:
        by.require_organizer()
    else:
        return teams.own(session, by)
    if team is None:
        raise ServiceError(ProblemCode.TEAM_REQUIRED, "An organizer's token belongs to no team; name one with `team`.")
    return teams.find_as_organizer(session, by, team)


def _find_or_add(session: Session, owner: Team, upload: CheckedUpload, stage: Stage) -> tuple[Submission, bool]:
    """Return the row of this content and whether it is new; locked, so that equal uploads wait for each other."""
    added = session.scalar(
        insert(Submission)
        .values(
            team_id=owner.id,
            kind=upload.kind,
            competition=stage.competition,
            track=upload.track,
            stage=stage.name,
            tasks=list(upload.tasks),
            name=upload.name,
            digest=upload.digest,
            archive_sha256=upload.archive_sha256,
            archive_bytes=upload.archive_bytes,
            manifest=upload.manifest,
            archive_sketch=upload.archive_sketch,
            contents=upload.contents,
            is_public=stage.rules.public_pages,
        )
        .on_conflict_do_nothing(
            index_elements=[
                Submission.team_id,
                Submission.competition,
                Submission.track,
                Submission.stage,
                Submission.kind,
                Submission.digest,
            ],
            index_where=Submission.merged_from.is_(None),
        )
        .returning(Submission.id)
    )
    existing = session.scalars(
        select(Submission)
        .where(
            Submission.team_id == owner.id,
            stage.submissions,
            Submission.kind == upload.kind,
            Submission.digest == upload.digest,
            Submission.merged_from.is_(None),
        )
        .with_for_update(key_share=True)
    ).one()
    return existing, added is not None
