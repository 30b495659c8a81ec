"""The teams of an export of receipts, with the names that they had before; the audit log knows them."""

from collections.abc import Collection, Iterator
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session

from ..db.models import AuditEntry, Evaluation, Submission, Team
from ..receipts.export import ExportedTeam


def read_teams(session: Session, evaluations: Collection[UUID]) -> tuple[ExportedTeam, ...]:
    """Return the teams of some evaluations, by name."""
    rows = session.execute(
        select(Team, Evaluation.id, Submission.disqualified_at)
        .join(Submission, Submission.team_id == Team.id)
        .join(Evaluation, Evaluation.submission_id == Submission.id)
        .where(Evaluation.id.in_(evaluations))
        .order_by(Team.name, Evaluation.id)
    )
    found: dict[Team, list[UUID]] = {}
    disqualified: set[UUID] = set()
    for team, evaluation, disqualified_at in rows:
        found.setdefault(team, []).append(evaluation)
        if disqualified_at is not None:
            disqualified.add(evaluation)
    return tuple(_exported(session, team, ids, disqualified.intersection(ids)) for team, ids in found.items())


def _exported(
    session: Session, team: Team, evaluations: Collection[UUID], disqualified: Collection[UUID]
) -> ExportedTeam:
    is_removed = team.erased_at is not None
    return ExportedTeam(
        name=team.name,
        evaluations=tuple(evaluations),
        former_names=() if is_removed else tuple(sorted(set(_former_names(session, str(team.id))) - {team.name})),
        off_boards=f"disqualified, {team.disqualified_for}" if team.disqualified_at is not None else None,
        disqualified=tuple(sorted(disqualified)),
        is_removed=is_removed,
    )


def _former_names(session: Session, team: str) -> Iterator[str]:
    """Yield the names that a team had, and those of the teams that were merged into it; one cannot be merged twice."""
    lines = session.scalars(
        select(AuditEntry).where(
            AuditEntry.subject == f"team:{team}", AuditEntry.action.in_(["team.rename", "team.merge"])
        )
    )
    for line in lines:
        before = line.before or {}
        if line.action == "team.rename":
            yield before["name"]
        else:
            yield before["teams"][0]
            yield from _former_names(session, before["merged"])
