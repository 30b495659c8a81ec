"""Names under which teams are shown: their own, or random ones until the end of an anonymous competition."""

from dataclasses import dataclass
from typing import Self
from uuid import NAMESPACE_OID, UUID, uuid5

from sqlalchemy.orm import Session

from ..competitions.competition import Competition
from ..database.models import Team
from ..principals import VISITOR, Principal


@dataclass(frozen=True, kw_only=True)
class ShownNames:
    """The names under which somebody sees teams.

    Attributes:
        by: who sees them.
        hidden: whether others' names are hidden now: by one competition (`Competition.hides_names`), so by the service,
            because teams and their pages belong to all competitions.
        to_organizer: whether who sees them organizes all competitions that hide names.
    """

    by: Principal
    hidden: bool
    to_organizer: bool = False

    @classmethod
    def read(cls, session: Session, by: Principal = VISITOR) -> Self:
        """Return those of now."""
        hiding = [one.name for one in Competition.read_all(session) if one.hides_names]
        return cls(by=by, hidden=bool(hiding), to_organizer=all(by.organizes(name) for name in hiding))

    def hides(self, team: Team) -> bool:
        """Return whether the team stays anonymous; its members, judges and organizers always see its name."""
        return self.hidden and not (self.to_organizer or self.by.may_see(team.id))

    def show_name(self, team: Team) -> str:
        """Return the name that is shown."""
        return team.pseudonym if self.hides(team) else team.name

    def name_for_others(self, team: Team) -> str:
        """Return the name that is shown to everybody else."""
        return team.pseudonym if self.hidden else team.name

    def show_id(self, team: Team) -> UUID:
        """Return the id that is shown: a hidden team's own one would reveal which team it is."""
        return uuid5(NAMESPACE_OID, team.pseudonym) if self.hides(team) else team.id
