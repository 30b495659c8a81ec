"""The one who asks, as far as the service layer needs to know."""

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from uuid import UUID

from .database.states import Role
from .errors import ProblemCode, ServiceError, not_found


@dataclass(frozen=True, kw_only=True)
class Principal:
    """Who asks: a member of a team (or whoever has its shared token), a judge, an organizer, or a visitor.

    Attributes:
        role: what may be done; None for a visitor without a token.
        team_id: of a team's token.
        team_name: of a team's token.
        team_pseudonym: under which others see that team while names are hidden.
        token_id: None for a visitor, and for the organizer's command line on the server machine.
        member_id: whose token it is; None: shared by the team.
        member_name: name of that member.
        leads_team: whether members may be invited and removed.
        judge_name: of a judge's token: under which marks and conflicts of interest are stored.
        competition: of an organizer of one competition: its name; None: of the whole service.
        signed_in_at: in a browser, when its session began; None: elsewhere.
    """

    role: Role | None
    team_id: UUID | None = None
    team_name: str | None = None
    team_pseudonym: str | None = None
    token_id: UUID | None = None
    member_id: UUID | None = None
    member_name: str | None = None
    leads_team: bool = False
    judge_name: str | None = None
    competition: str | None = None
    signed_in_at: datetime | None = None

    @property
    def organizes_service(self) -> bool:
        """Whether all things of the whole service may be seen and changed."""
        return self.role is Role.ORGANIZER and self.competition is None

    @property
    def organizes_any(self) -> bool:
        """Whether all things of one competition, or of the whole service, may be seen and changed."""
        return self.role is Role.ORGANIZER

    @property
    def reads_all_teams(self) -> bool:
        """Whether all teams' submissions may be read."""
        return self.organizes_service or self.role is Role.JUDGE

    @property
    def actor(self) -> str:
        """Name in the audit log."""
        return f"{self.account}/{self.member_name}" if self.member_name else self.account

    @property
    def account(self) -> str:
        """For whom uploads and event streams are counted: the members of a team share its limits."""
        return f"{self.role}:{self.team_name or self.judge_name or self.token_id or 'console'}"

    def organizes(self, competition: str) -> bool:
        """Return whether all things of a competition may be seen and changed; of practice where it has no name."""
        return self.role is Role.ORGANIZER and self.competition in {None, competition}

    def may_see(self, team_id: UUID, competition: str | None = None) -> bool:
        """Return whether a thing of that team exists for this principal; `competition`: to which the thing belongs."""
        organizes = competition is not None and self.organizes(competition)
        return self.reads_all_teams or self.team_id == team_id or organizes

    def may_change(self, team_id: UUID, competition: str | None = None) -> bool:
        """Return whether this principal may change a thing of that team; `competition`: to which the thing belongs."""
        organizes = competition is not None and self.organizes(competition)
        return self.organizes_service or self.team_id == team_id or organizes

    def require_leader(self, team_id: UUID) -> None:
        """Refuse everybody but the captain of that team and organizers.

        Raises:
            ServiceError: not_found for other teams, else forbidden.
        """
        if not self.may_change(team_id):
            raise not_found("team", team_id)
        if not (self.organizes_service or self.leads_team):
            raise ServiceError(ProblemCode.FORBIDDEN, "Only the team's captain and organizers may do this.")

    def require_organizer(self, competition: str | None = None) -> None:
        """Refuse everybody else; `competition`: to which the thing belongs, None: to the whole service.

        Raises:
            ServiceError: forbidden.
        """
        if self.organizes_service or (competition is not None and self.organizes(competition)):
            return
        if not self.organizes_any:
            raise ServiceError(ProblemCode.FORBIDDEN, "Only organizers may do this; use an organizer's token.")
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            f"Your token organizes the competition {self.competition}, and this concerns "
            f"{competition or 'the whole service'}; ask an organizer of the whole service.",
        )


class Audience(StrEnum):
    """Who may call a route of the API, as its declaration and description say.

    What the role alone decides is decided here; to whom a thing belongs, the functions that read it know.
    """

    EVERYBODY = "everybody"
    """Also without a token."""
    SIGNED_IN = "signed in"
    """Whoever has a token."""
    TEAMS = "teams"
    SUBMITTERS = "submitters"
    """Teams, and organizers in their place."""
    READERS = "readers"
    """The team whose thing it is, judges and organizers."""
    OWNERS = "owners"
    """The team whose thing it is, and organizers."""
    CAPTAINS = "captains"
    """Whoever leads the team whose thing it is, and organizers."""
    JUDGES = "judges"
    """Judges, and organizers in their place."""
    COMPETITION_ORGANIZERS = "organizers of the competition"
    """Those of the service, and those of the competition only."""
    ORGANIZERS = "organizers"
    """Those of the whole service."""

    def require(self, principal: Principal, competition: str | None) -> None:
        """Refuse a principal of whom the role says that they may not.

        Raises:
            ServiceError: forbidden.
        """
        match self:
            case Audience.ORGANIZERS:
                principal.require_organizer()
            case Audience.COMPETITION_ORGANIZERS:
                principal.require_organizer(competition or principal.competition)
            case Audience.JUDGES if principal.role not in {Role.JUDGE, Role.ORGANIZER}:
                raise ServiceError(ProblemCode.FORBIDDEN, "Only judges and organizers may do this.")
            case Audience.TEAMS if principal.team_id is None:
                raise ServiceError(ProblemCode.FORBIDDEN, "Only teams may do this; use a team's token.")


VISITOR = Principal(role=None)
"""Whoever asks without a token."""
CONSOLE = Principal(role=Role.ORGANIZER)
"""Whoever runs commands on the server machine: has the database's password, so may do everything."""
