"""The one who asks, as far as the service layer needs to know."""

from dataclasses import dataclass
from uuid import UUID

from vitac.server.db.states import Role
from vitac.server.errors import ProblemCode, ServiceError


@dataclass(frozen=True, kw_only=True)
class Principal:
    """A team, a judge or an organizer. `token_id` is None for the organizer's command line on the server machine."""

    role: Role
    team_id: UUID | None = None
    team_name: str | None = None
    token_id: UUID | None = None

    @property
    def is_organizer(self) -> bool:
        """Whether all teams' things may be seen and changed."""
        return self.role is Role.ORGANIZER

    @property
    def reads_all_teams(self) -> bool:
        """Whether all teams' submissions may be read."""
        return self.role in {Role.ORGANIZER, Role.JUDGE}

    @property
    def actor(self) -> str:
        """Name in the audit log."""
        return f"{self.role.value}:{self.team_name or self.token_id or 'console'}"

    def may_see(self, team_id: UUID) -> bool:
        """Return whether a thing of that team exists for this principal."""
        return self.reads_all_teams or self.team_id == team_id

    def may_change(self, team_id: UUID) -> bool:
        """Return whether this principal may change a thing of that team."""
        return self.is_organizer or self.team_id == team_id

    def require_organizer(self) -> None:
        """Refuse everybody else.

        Raises:
            ServiceError: forbidden.
        """
        if not self.is_organizer:
            raise ServiceError(ProblemCode.FORBIDDEN, "Only organizers may do this; use an organizer's token.")


CONSOLE = Principal(role=Role.ORGANIZER)
"""Whoever runs commands on the server machine: has the database's password, so may do everything."""
