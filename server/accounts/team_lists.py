"""Many teams at once: those of a CSV file with invitations for captains, and what organizers search and change."""

import csv
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from sqlalchemy import ColumnElement, and_, func, or_, select
from sqlalchemy.orm import Session

from .. import names
from ..audit import record
from ..database.models import Member, Submission, Team
from ..errors import ProblemCode, ServiceError
from ..principals import Principal
from ..views.teams import ImportedTeamView, ListedTeamView, TeamState
from . import members, teams
from .messages import publish_announcement

MAX_IMPORTED = 1000
_TOLD_PROBLEMS = 10
_COLUMNS: Mapping[str, str] = {
    "name": "name", "team": "name", "team name": "name",
    "contact": "contact", "email": "contact", "e-mail": "contact", "mail": "contact",
}  # fmt: skip
"""How the columns of a file may be called. What is in all further ones becomes the note."""


class BulkAction(StrEnum):
    """What organizers do with several teams at once."""

    ACCEPT = "accept"
    REFUSE = "refuse"
    DISQUALIFY = "disqualify"
    REINSTATE = "reinstate"
    MESSAGE = "message"


@dataclass(frozen=True, kw_only=True)
class TeamSearch:
    """Which teams are listed.

    Attributes:
        text: part of name, contact or note, in any case; empty: all.
        state: only those in this state; None: in any.
        competition: only those with a submission to this one; None: all.
    """

    text: str = ""
    state: TeamState | None = None
    competition: str | None = None

    def conditions(self) -> Iterator[ColumnElement[bool]]:
        """Yield the conditions of a query."""
        if self.text:
            wanted = self.text.strip().lower()
            columns = (Team.name, Team.contact, Team.note)
            yield or_(*(func.lower(column).contains(wanted, autoescape=True) for column in columns))
        if self.state is not None:
            yield _STATES[self.state]
        if self.competition is not None:
            yield Team.id.in_(select(Submission.team_id).where(Submission.competition == self.competition))


_TAKES_PART = Team.approved_at.is_not(None) & Team.disqualified_at.is_(None) & Team.erased_at.is_(None)
_STATES: Mapping[TeamState, ColumnElement[bool]] = {
    TeamState.WAITING: and_(Team.approved_at.is_(None), Team.refused_for.is_(None), Team.erased_at.is_(None)),
    TeamState.ACCEPTED: _TAKES_PART,
    TeamState.REFUSED: Team.refused_for.is_not(None),
    TeamState.DISQUALIFIED: Team.disqualified_at.is_not(None),
    TeamState.REMOVED: Team.erased_at.is_not(None),
}


def list_teams(session: Session, by: Principal, search: TeamSearch) -> list[ListedTeamView]:
    """Return the teams that a search finds, by name; those that wait by how long they have waited.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer()
    order = (Team.created_at, Team.id) if search.state is TeamState.WAITING else (Team.name_key,)
    listed = session.scalars(select(Team).where(*search.conditions()).order_by(*order)).all()
    submissions = _count_by_team(session, select(Submission.team_id, func.count()).group_by(Submission.team_id))
    present = select(Member.team_id, func.count()).where(Member.left_at.is_(None)).group_by(Member.team_id)
    people = _count_by_team(session, present)
    return [
        ListedTeamView(
            **dict(teams.organizer_team_view(session, team)),
            state=_find_state(team),
            note=team.note,
            members=people.get(team.id, 0),
            submissions=submissions.get(team.id, 0),
        )
        for team in listed
    ]


def _count_by_team(session: Session, query: object) -> dict[object, int]:
    return dict(session.execute(query).all())  # type: ignore[call-overload]


def _find_state(team: Team) -> TeamState:
    if team.erased_at is not None:
        return TeamState.REMOVED
    if team.disqualified_at is not None:
        return TeamState.DISQUALIFIED
    if team.approved_at is not None:
        return TeamState.ACCEPTED
    return TeamState.REFUSED if team.refused_for is not None else TeamState.WAITING


def import_teams(session: Session, by: Principal, content: str) -> list[ImportedTeamView]:
    """Make the teams of a CSV file, accepted and each with an invitation for its captain; all of them or none.

    Args:
        session: of the transaction.
        by: an organizer.
        content: of the file: a row of names with `name` and, if wanted, `contact`; further columns become the note.

    Raises:
        ServiceError: not an organizer, or with a sentence for each line that is wrong.
    """
    by.require_organizer()
    made, problems = [], []
    for line, row in _read_rows(content):
        try:
            made.append(_import_team(session, by, row))
        except ServiceError as error:
            problems.append(f"Line {line}: {error.detail}")
    if problems:
        more = f" And {len(problems) - _TOLD_PROBLEMS} more." if len(problems) > _TOLD_PROBLEMS else ""
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"No team was imported. {' '.join(problems[:_TOLD_PROBLEMS])}{more}"
        )
    return made


def _import_team(session: Session, by: Principal, row: Mapping[str, str]) -> ImportedTeamView:
    given = row["contact"]
    contact = names.clean(given, what="A contact", min_length=2, max_length=teams.CONTACT_LENGTH) if given else None
    team = teams.register(session, by, name=row["name"], contact=contact)
    change_note(session, by, team, row["note"])
    invitation, code = members.invite(session, by, team, leads=True)
    return ImportedTeamView(id=team.id, name=team.name, contact=contact, code=code, expires_at=invitation.expires_at)


def _read_rows(content: str) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Yield the rows of a file with the number of the line at which each ends.

    Raises:
        ServiceError: it has no column of names, no row, or too many.
    """
    text = content.removeprefix("\N{ZERO WIDTH NO-BREAK SPACE}").lstrip()
    header = text.partition("\n")[0]
    separator = max(",;\t", key=header.count)
    reader = csv.reader(io.StringIO(text), delimiter=separator)
    titles = [title.strip() for title in next(reader, [])]
    fields = [_COLUMNS.get(title.lower()) for title in titles]
    if fields.count("name") != 1:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected a first line with one column `name`, got {', '.join(titles)[:200] or 'an empty file'}. Write "
            "there the names of the columns: name, contact, and others, which become the note.",
        )
    rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    if not 0 < len(rows) <= MAX_IMPORTED:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected 1 to {MAX_IMPORTED} lines with teams, got {len(rows)}."
        )
    for line, row in rows:
        yield line, _read_row(titles, fields, row)


def _read_row(titles: Sequence[str], fields: Sequence[str | None], row: Sequence[str]) -> Mapping[str, str]:
    cells = dict(enumerate(cell.strip() for cell in row))
    notes = [f"{titles[at]}: {cells[at]}" for at, field in enumerate(fields) if field is None and cells.get(at)]
    named = {field: cells.get(at, "") for at, field in enumerate(fields) if field is not None}
    return {"contact": "", **named, "note": "\n".join(notes)}


def change_note(session: Session, by: Principal, team: Team, note: str) -> None:
    """Keep what organizers write about a team, which nobody else reads.

    Raises:
        ServiceError: not an organizer, or it cannot be shown.
    """
    by.require_organizer()
    before, text = team.note, names.clean_text(note, what="A note") if note.strip() else ""
    if text != before:
        team.note = text
        # Not `team.`: members read those entries of the audit log.
        record(session, by, "note.change", f"team:{team.id}", {"note": text}, before={"note": before})


def change_teams(
    session: Session, by: Principal, chosen: Collection[str], action: BulkAction, *, reason: str, title: str, text: str
) -> list[Team]:
    """Do the same with several teams, all or none.

    Args:
        session: of the transaction.
        by: an organizer.
        chosen: names or ids.
        action: what is done.
        reason: why they are refused or disqualified.
        title: of a message.
        text: of a message.

    Raises:
        ServiceError: not an organizer, there is no such team, or it is refused for one of them, which is named.
    """
    by.require_organizer()
    changed = sorted({teams.find(session, name) for name in chosen}, key=lambda team: team.id)
    for team in changed:
        try:
            _change(session, by, team, action, reason=reason, title=title, text=text)
        except ServiceError as error:
            raise ServiceError(error.code, f"No team was changed. {team.name}: {error.detail}") from error
    return sorted(changed, key=lambda team: team.name_key)


def _change(
    session: Session, by: Principal, team: Team, action: BulkAction, *, reason: str, title: str, text: str
) -> None:
    match action:
        case BulkAction.ACCEPT:
            teams.accept(session, by, team)
        case BulkAction.REFUSE:
            teams.refuse(session, by, team, reason)
        case BulkAction.DISQUALIFY:
            teams.disqualify(session, by, team, reason)
        case BulkAction.REINSTATE:
            teams.reinstate(session, by, team)
        case BulkAction.MESSAGE:
            publish_announcement(session, by, title=title, text=text, notify=True, team=team)
