"""Says to teams that a stage closes soon; called regularly by the sender."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import select
from sqlalchemy.orm import Session

from ..competition.competition import Competition
from ..db.models import Team
from ..db.states import NoticeKind
from .outbox import announce, stage_facts

NEAR = timedelta(hours=24)


def announce_near(session: Session, at: datetime | None = None) -> None:
    """Write one notice for each stage that closes within a day, to each team that may submit to it.

    A stage whose closing instant is moved gets another one. `at` is the moment, None: now.
    """
    now = at or datetime.now(UTC)
    open_stages = (stage for one in Competition.read_all(session) for stage in one.stages if stage.is_open(now))
    near = [stage for stage in open_stages if stage.rules.closes - now <= NEAR]
    if not near:
        return
    taking_part = select(Team).where(Team.approved_at.is_not(None), Team.disqualified_at.is_(None))
    for team in session.scalars(taking_part).all():
        for stage in near:
            if stage.may_submit(team):
                closes = f"{stage.rules.closes:%F %H:%M} UTC"
                facts = stage_facts(stage) | {"closes": closes}
                announce(session, NoticeKind.DEADLINE, team.id, f"{stage.subject}/{closes}", facts)
