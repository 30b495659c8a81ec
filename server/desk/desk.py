"""Reads what waits for an organizer; called by the page of the desk."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from ..appeals import appeals
from ..audit import entry_view, newest_entries
from ..messages import announcements, questions
from ..principals import Principal
from ..teams import teams
from ..views.appeals import AppealView
from ..views.messages import AnnouncementView, QuestionView
from ..views.teams import AuditEntryView, OrganizerTeamView
from .troubles import StageState, Trouble, stages, troubles

N_ENTRIES = 20


@dataclass(frozen=True, kw_only=True)
class Desk:
    """What organizers look at often; those of one competition see its submissions, appeals and stages.

    Attributes:
        waiting: teams that wait to be accepted.
        troubles: submissions that somebody has to look at.
        asked: questions without an answer.
        appealed: appeals without a ruling.
        stages: of the competition, with who may take part.
        said: announcements that everybody sees.
        entries: the last lines of the audit log.
    """

    troubles: Sequence[Trouble]
    appealed: Sequence[AppealView]
    stages: Sequence[StageState]
    waiting: Sequence[OrganizerTeamView] = ()
    asked: Sequence[QuestionView] = ()
    said: Sequence[AnnouncementView] = ()
    entries: Sequence[AuditEntryView] = ()


def read_desk(session: Session, by: Principal) -> Desk:
    """Return the desk of an organizer.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(by.competition)
    of_own = Desk(
        troubles=troubles(session, by),
        appealed=appeals.visible(session, by, open_only=True),
        stages=stages(session, by),
    )
    if not by.is_organizer:
        return of_own
    return replace(
        of_own,
        waiting=[teams.organizer_team_view(session, team) for team in teams.waiting(session)],
        asked=questions.visible(session, by, open_only=True),
        said=announcements.shown(session),
        entries=[entry_view(entry) for entry in newest_entries(session, N_ENTRIES)],
    )
