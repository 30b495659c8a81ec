"""Makes submissions out of checked uploads, in one transaction with their evaluation and its jobs."""

from sqlalchemy import select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session

from ..accounts import teams
from ..accounts.audit import record
from ..accounts.principals import Principal
from ..db.models import Submission, Team
from ..errors import ProblemCode, ServiceError
from ..evaluations import lifecycle
from ..uploads.checked_upload import CheckedUpload
from .runs import next_run


def create(
    session: Session, by: Principal, upload: CheckedUpload, *, team: str | None = None, again: bool = False
) -> tuple[Submission, bool]:
    """Make the submission and its evaluation, or find the one that exists; whether a new evaluation was started.

    The same content of the same team is one submission. While its evaluation is active or completed nothing new is
    started, unless `again` asks for a run that uses no stored episodes; after a cancel the run is taken up where it
    ended, after a failure a new run begins.

    Raises:
        ServiceError: an organizer named no team.
    """
    team_row = owner(session, by, team)
    submission = _find_or_add(session, team_row, upload)
    run = next_run(session, submission, again=again)
    if run is None:
        return submission, False
    lifecycle.start(session, submission, run)
    record(session, by, "submission.evaluate", f"submission:{submission.id}", {"run": run, "digest": upload.digest})
    return submission, True


def owner_name(session: Session, by: Principal, team: str | None) -> str:
    """Return the name of the team whose submission an upload becomes.

    Raises:
        ServiceError: an organizer named no team, or none that exists.
    """
    return owner(session, by, team).name


def owner(session: Session, by: Principal, team: str | None) -> Team:
    """Return the team whose submission an upload becomes.

    Raises:
        ServiceError: an organizer named no team, or none that exists.
    """
    if not by.is_organizer:
        return teams.own(session, by)
    if team is None:
        raise ServiceError(ProblemCode.TEAM_REQUIRED, "An organizer's token belongs to no team; name one with `team`.")
    return teams.find(session, team)


def _find_or_add(session: Session, owner: Team, upload: CheckedUpload) -> Submission:
    """Return the row of this content, locked: two equal uploads at once go on one after the other."""
    session.execute(
        insert(Submission)
        .values(
            team_id=owner.id,
            kind=upload.kind,
            track=upload.track,
            tasks=list(upload.tasks),
            name=upload.name,
            digest=upload.digest,
            archive_sha256=upload.archive_sha256,
            archive_bytes=upload.archive_bytes,
            manifest=upload.manifest,
        )
        .on_conflict_do_nothing(
            index_elements=[Submission.team_id, Submission.track, Submission.kind, Submission.digest]
        )
    )
    return session.scalars(
        select(Submission)
        .where(
            Submission.team_id == owner.id,
            Submission.track == upload.track,
            Submission.kind == upload.kind,
            Submission.digest == upload.digest,
        )
        .with_for_update(key_share=True)
    ).one()
