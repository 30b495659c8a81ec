"""Says to teams that a stage closes soon; called regularly by the sender."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import select
from sqlalchemy.orm import Session

from ..contest.stages import current, is_qualified
from ..db.models import Team
from ..db.states import NoticeKind
from .outbox import announce, stage_facts

NEAR = timedelta(hours=24)


def announce_near(session: Session, at: datetime | None = None) -> None:
    """Write one notice for each stage that closes within a day, to each team that may submit to it.

    A stage whose closing instant is moved gets another one. `at` is the moment, None: now.
    """
    competition, now = current(session), at or datetime.now(UTC)
    if competition is None:
        return
    near = [
        (name, stage)
        for name, track in competition.tracks.items()
        for stage in track.stages
        if track.taken_here and stage.is_open(now) and stage.closes - now <= NEAR
    ]
    if not near:
        return
    taking_part = select(Team).where(Team.approved_at.is_not(None), Team.disqualified_at.is_(None))
    for team in session.scalars(taking_part).all():
        for track, stage in near:
            if stage.qualified is None or is_qualified(session, team, track, stage.name):
                closes = f"{stage.closes:%F %H:%M} UTC"
                facts = stage_facts(competition, track, stage.name) | {"closes": closes}
                announce(session, NoticeKind.DEADLINE, team.id, f"stage:{track}/{stage.name}/{closes}", facts)
