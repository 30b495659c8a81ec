"""What a judge looks at before giving marks: entries of the judged tracks, their figures, the judge's marks."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.tracks import load_track

from ..competitions.competition import Competition
from ..competitions.definition import Judging
from ..competitions.stages import Stage
from ..database.models import JudgingConflict, JudgingMark, Submission
from ..errors import ProblemCode, ServiceError
from ..leaderboards.standings import leaderboard
from ..principals import Principal
from ..views.decisions import JudgedTeamView
from ..views.leaderboards import LeaderboardEntryView
from .judging import figures_of_entry, judged


@dataclass(frozen=True, kw_only=True)
class SheetEntry:
    """An entry to be judged.

    Attributes:
        entry: as on the board.
        figures: of the sensor, as the judge may see them; None where it has none, or they are not measured yet.
        marks: that this judge gave, by criterion; empty before that.
        conflict: why this judge does not judge the team; None: the judge does.
    """

    entry: LeaderboardEntryView
    figures: SensorFigures | None
    marks: dict[str, float]
    conflict: str | None


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A judged track.

    Attributes:
        has_sensors: whether entries bring sensors, which have pages with their design documents.
        entries: of its last stage, in the order of the board.
        judged: what follows from the marks of all judges, best first; empty for a judge.
    """

    track: str
    title: str
    rubric: Judging
    has_sensors: bool
    entries: Sequence[SheetEntry]
    judged: Sequence[JudgedTeamView]


def sheets(session: Session, by: Principal) -> list[Sheet]:
    """Return a sheet for each judged track that is held here.

    Raises:
        ServiceError: neither a judge nor an organizer.
    """
    if not (by.reads_all_teams or by.organizes_any):
        raise ServiceError(ProblemCode.FORBIDDEN, "Only judges and organizers may do this; sign in with their token.")
    return [
        _sheet(session, by, stage, stage.track_rules.judging)
        for competition in Competition.read_all(session)
        for stage in competition.last_stages
        if stage.track_rules.judging is not None and (by.reads_all_teams or by.organizes(competition.name))
    ]


def _sheet(session: Session, by: Principal, stage: Stage, rubric: Judging) -> Sheet:
    board = leaderboard(session, stage, live=True).view.entries
    return Sheet(
        track=stage.track,
        title=stage.track_rules.title,
        rubric=rubric,
        has_sensors=load_track(stage.track).has_sensor,
        entries=[_entry(session, by, entry) for entry in board],
        judged=judged(session, by, stage) if by.organizes(stage.competition) else (),
    )


def _entry(session: Session, by: Principal, entry: LeaderboardEntryView) -> SheetEntry:
    judge = by.judge_name or ""  # an organizer has no marks
    given = select(JudgingMark).where(JudgingMark.submission_id == entry.submission_id, JudgingMark.judge == judge)
    team_id = session.get_one(Submission, entry.submission_id).team_id
    conflict = session.get(JudgingConflict, (team_id, judge))
    return SheetEntry(
        entry=entry,
        figures=figures_of_entry(session, by, entry),
        marks={row.criterion: row.mark for row in session.scalars(given)},
        conflict=conflict.reason if conflict else None,
    )
