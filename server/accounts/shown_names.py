"""Under which names teams are shown: their own, or until the end of an anonymous competition ones that tell nothing."""

from uuid import NAMESPACE_OID, UUID, uuid5

from sqlalchemy.orm import Session, object_session

from ..db.models import Competition, Team
from .principals import VISITOR, Principal


def are_hidden(session: Session) -> bool:
    """Return whether teams are shown to others under random names: the competition says so, and is not final."""
    row = session.get(Competition, 1)
    return row is not None and row.finalized_at is None and bool(row.definition.get("anonymous"))


def is_hidden(team: Team, by: Principal) -> bool:
    """Return whether somebody may not see which team it is; its members, judges and organizers may."""
    session = object_session(team)
    return session is not None and not by.may_see(team.id) and are_hidden(session)


def shown_name(team: Team, by: Principal = VISITOR) -> str:
    """Return the name under which somebody sees a team."""
    return team.pseudonym if is_hidden(team, by) else team.name


def shown_id(team: Team, by: Principal) -> UUID:
    """Return the id under which somebody sees a team: its own one would tell which it was elsewhere."""
    return uuid5(NAMESPACE_OID, team.pseudonym) if is_hidden(team, by) else team.id
