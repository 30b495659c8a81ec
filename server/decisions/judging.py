"""Judges' marks, and the sheets on which they give them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from statistics import fmean, stdev
from uuid import UUID

from sqlalchemy import ColumnElement, delete, select
from sqlalchemy.orm import Session
from vitac.evaluator.figures.figures import SensorFigures
from vitac.evaluator.tracks import load_track

from ..accounts import teams, tokens
from ..audit import record
from ..competitions.competition import Competition
from ..competitions.definition import Judging
from ..competitions.stages import Stage
from ..database.models import Evaluation, JudgingConflict, JudgingMark, Submission
from ..errors import ProblemCode, ServiceError
from ..evaluations.history import newest_evaluation
from ..evaluations.scores import counted_tasks
from ..leaderboards.standings import leaderboard
from ..principals import CONSOLE, Principal
from ..submissions.sensors import read_figures
from ..views.decisions import JudgedCriterionView, JudgedTeamView
from ..views.leaderboards import LeaderboardEntryView
from ..visibility import decide_sight, visible

BEST_MARK = 10.0


def give_marks(
    session: Session, by: Principal, submission_id: UUID, marks: Mapping[str, float], *, judge: str | None = None
) -> None:
    """Keep a judge's marks of a submission, in place of those that the judge gave before.

    Args:
        session: of the transaction.
        by: a judge, or an organizer who writes down what a judge says.
        submission_id: which one.
        marks: from 0 to 10 for every criterion of the track.
        judge: for an organizer: who gave them.

    Raises:
        ServiceError: not a judge or organizer, no such submission, its track is not judged, the competition is final,
            it plays no task of the ranking that a total is made for, a mark is missing or out of range, or the judge
            is not named in the file or has a conflict of interest with the team.
    """
    submission = visible(session, by, submission_id)
    name = _judge(session, by, judge, submission.competition)
    teams.lock(session, submission.team)  # no conflict and no other marks of the team meanwhile
    # The end, and the same judge's marks from elsewhere, wait for these.
    competition = Competition.lock(session, submission.competition)
    competition.require_not_final()
    rubric = find_rubric(competition, submission.track)
    _require_named([rubric], name)
    _require_ranked_task(session, submission)
    _require_whole(rubric, marks)
    conflict = session.get(JudgingConflict, (submission.team_id, name))
    if conflict is not None:
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            f"{name} declared a conflict of interest with {submission.team.name}: {conflict.reason}. Somebody else "
            "has to judge.",
        )
    before = _take_away(session, name, JudgingMark.submission_id == submission.id)
    session.add_all(
        JudgingMark(submission_id=submission.id, judge=name, criterion=criterion, mark=mark)
        for criterion, mark in marks.items()
    )
    session.flush()
    subject = f"submission:{submission.id}"
    record(session, by, "judging.mark", subject, {"judge": name, "marks": dict(marks)}, before=before)


def declare_conflict(session: Session, by: Principal, team: str, reason: str, *, judge: str | None = None) -> None:
    """Note that a judge has a conflict of interest with a team; its marks by the judge go, but in final competitions.

    Args:
        session: of the transaction.
        by: a judge, or an organizer who writes it down.
        team: name or id.
        reason: in words.
        judge: for an organizer: whose conflict it is.

    Raises:
        ServiceError: not a judge or organizer, one whom no file names, no such team, or all competitions are final.
    """
    name = _judge(session, by, judge)
    _require_named(_list_open_rubrics(session), name)
    conflicting = teams.find(session, team)
    teams.lock(session, conflicting)  # before the competition, as for marks
    # The end, and the same judge's marks from elsewhere, wait for these.
    competitions = [Competition.lock(session, one) for one in sorted(one.name for one in Competition.read_all(session))]
    final = [one for one in competitions if one.row.finalized_at is not None]
    if len(final) == len(competitions):
        final[0].require_not_final()
    of_team = Submission.team_id == conflicting.id, Submission.competition.not_in([one.name for one in final])
    mine = JudgingMark.submission_id.in_(select(Submission.id).where(*of_team))
    before = _take_away(session, name, mine)
    row = session.get(JudgingConflict, (conflicting.id, name))
    if row is None:
        session.add(JudgingConflict(team_id=conflicting.id, judge=name, reason=reason))
    else:
        row.reason = reason
    session.flush()
    record(session, by, "judging.conflict", f"team:{conflicting.id}", {"judge": name, "reason": reason}, before=before)


def judged(session: Session, by: Principal, stage: Stage) -> list[JudgedTeamView]:
    """Return the teams on a stage's board with marks, figures and total; the best total first, those without one last.

    Raises:
        ServiceError: not an organizer, or the track is not judged.
    """
    by.require_organizer(stage.competition)
    rubric = find_rubric(Competition.read(session, stage.competition), stage.track)
    return _sort_by_total(session, rubric, leaderboard(session, stage, live=True).view.entries)


def ranked_by_total(session: Session, stage: Stage) -> list[tuple[LeaderboardEntryView, float]]:
    """Return the ranked entries of a stage's board with their totals, best first; the board decides between equal ones.

    Raises:
        ServiceError: the track is not judged, or an entry has no total yet.
    """
    board = leaderboard(session, stage, live=True).view.entries
    entries = {entry.submission_id: entry for entry in board if entry.rank is not None}
    rubric = find_rubric(Competition.read(session, stage.competition), stage.track)
    by_total = _sort_by_total(session, rubric, list(entries.values()))
    if missing := [f"{team.team} ({_missing(rubric, team)})" for team in by_total if team.total is None]:
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Expected a total for every team of {stage}, got none for {', '.join(missing)}. Let "
            "judges give marks, requeue what has no figures, or change `judging` in the competition's file.",
        )
    return [(entries[team.submission], team.total) for team in by_total if team.total is not None]


def find_rubric(competition: Competition, track: str) -> Judging:
    """Return how a track of a competition is judged.

    Raises:
        ServiceError: it is not.
    """
    rules = competition.definition.tracks.get(track)
    if rules is None or rules.judging is None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"{track} is not judged; give it `judging` in the competition's file."
        )
    return rules.judging


def percentiles(figures: Mapping[UUID, SensorFigures | None]) -> dict[UUID, float | None]:
    """Return for each sensor the share of the others that it is better than, as a mean over all figures.

    An equal one counts half; of a single sensor it is 1. Figures: information of three pictures, motion of the markers
    per newton (normal, shear), smallest shift of a pin that can be detected, least success under a variation.
    """
    values = {submission: _values(measured) for submission, measured in figures.items() if measured is not None}
    return {
        submission: _share(values[submission], [other for key, other in values.items() if key != submission])
        if submission in values
        else None
        for submission in figures
    }


def _values(figures: SensorFigures) -> tuple[float, ...]:
    """Return the figures, larger being better; one that was not measured is the worst."""
    bits = figures.information.bits[-1] if figures.information else -1.0
    least = min((each.success_rate for each in figures.robustness), default=-1.0)
    touch = figures.touch
    normal, shear = (-1.0 if value is None else value for value in (touch.normal_px_n, touch.shear_px_n))
    return (bits, normal, shear, -inf if touch.pin_mm is None else -touch.pin_mm, least)


def _share(own: Sequence[float], others: Sequence[Sequence[float]]) -> float:
    if not others:
        return 1.0
    return fmean(
        fmean(1.0 if mine > theirs else 0.5 if mine == theirs else 0.0 for mine, theirs in zip(own, other, strict=True))
        for other in others
    )


def figures_of_entry(session: Session, by: Principal, entry: LeaderboardEntryView) -> SensorFigures | None:
    """Return what somebody may see of the figures of an entry's sensor; None without a sensor, or if not measured."""
    evaluation = session.get_one(Evaluation, entry.evaluation_id)
    if not load_track(evaluation.submission.track).has_sensor:
        return None
    return read_figures(session, evaluation.submission, evaluation, with_starts=decide_sight(by, evaluation).episodes)


def _sort_by_total(session: Session, rubric: Judging, entries: Sequence[LeaderboardEntryView]) -> list[JudgedTeamView]:
    """Return the teams of entries, the best total first, those without one last, else in the order given."""
    figures = percentiles({entry.submission_id: figures_of_entry(session, CONSOLE, entry) for entry in entries})
    judged_teams = [_judged(session, rubric, entry, figures[entry.submission_id]) for entry in entries]
    return sorted(judged_teams, key=lambda team: (team.total is None, -(team.total or 0.0)))


def _missing(rubric: Judging, team: JudgedTeamView) -> str:
    """Return in words why a team has no total."""
    needs_judges = rubric.weights.judges and len(team.judges) < rubric.judges_at_least
    return f"{len(team.judges)} of {rubric.judges_at_least} judges" if needs_judges else "no figures"


def _judged(session: Session, rubric: Judging, entry: LeaderboardEntryView, figures: float | None) -> JudgedTeamView:
    rows = session.scalars(select(JudgingMark).where(JudgingMark.submission_id == entry.submission_id)).all()
    team_id = session.get_one(Submission, entry.submission_id).team_id
    conflicts = session.scalars(select(JudgingConflict.judge).where(JudgingConflict.team_id == team_id)).all()
    names = [criterion.name for criterion in rubric.criteria]
    known = [row for row in rows if row.criterion in names and row.judge not in conflicts]
    by_judge = {
        judge: fmean(row.mark for row in known if row.judge == judge) for judge in sorted({row.judge for row in known})
    }
    mark = fmean(by_judge.values()) if by_judge else None
    return JudgedTeamView(
        team=entry.team,
        submission=entry.submission_id,
        success_rate=entry.success_rate,
        judges=tuple(by_judge),
        conflicts=tuple(sorted(conflicts)),
        set_aside=tuple(sorted({row.judge for row in rows} & set(conflicts))),
        criteria=tuple(
            _criterion(name, [row.mark for row in known if row.criterion == name]) for name in names if known
        ),
        mark=mark,
        spread=_spread(list(by_judge.values())),
        figures=figures,
        total=_total(rubric, entry.success_rate, mark if len(by_judge) >= rubric.judges_at_least else None, figures),
    )


def _criterion(name: str, marks: Sequence[float]) -> JudgedCriterionView:
    return JudgedCriterionView(criterion=name, mean=fmean(marks), spread=_spread(marks))


def _spread(values: Sequence[float]) -> float | None:
    return stdev(values) if len(values) > 1 else None


def _total(rubric: Judging, success_rate: float, mark: float | None, figures: float | None) -> float | None:
    """Return the total, rounded so that equal ones are equal in whatever order they were added up."""
    weights = rubric.weights
    if (mark is None and weights.judges) or (figures is None and weights.figures):
        return None
    measured = weights.success * success_rate + weights.figures * (figures or 0.0)
    return round(measured + weights.judges * (mark or 0.0) / BEST_MARK, 9)


def _judge(session: Session, by: Principal, named: str | None, competition: str | None = None) -> str:
    """Return the name under which marks are stored: that of the judge's token, or whom the organizer names."""
    if by.judge_name is not None:
        return by.judge_name
    by.require_organizer(competition)
    if not named:
        raise ServiceError(ProblemCode.INVALID_REQUEST, "Name the judge who gave the marks.")
    return tokens.judge_named(session, named)


def _list_open_rubrics(session: Session) -> list[Judging]:
    competitions = [one for one in Competition.read_all(session) if one.row.finalized_at is None]
    return [track.judging for one in competitions for track in one.definition.tracks.values() if track.judging]


def _require_named(rubrics: Sequence[Judging], judge: str) -> None:
    """Refuse a judge whom none of some judged tracks names, unless one takes every judge.

    Raises:
        ServiceError: forbidden, with those who judge.
    """
    named = [rubric.judges for rubric in rubrics]
    if named and all(named) and not any(judge in judges for judges in named):
        judges = ", ".join(sorted({one for some in named for one in some}))
        raise ServiceError(
            ProblemCode.FORBIDDEN,
            f"{judge!r:.80} is no judge by the competition's file, expected one of {judges}. Use that name, or add "
            "another one to `judging.judges` in the file.",
        )


def _require_ranked_task(session: Session, submission: Submission) -> None:
    runs_policy = submission.kind.form.runs_policy  # a log counts on the board of its own task
    ranked = (
        counted_tasks(newest_evaluation(session, submission))
        if runs_policy
        else load_track(submission.track).tasks_that_count
    )
    if set(ranked).isdisjoint(submission.tasks):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected an entry that plays {' or '.join(ranked)}, by which {submission.track} is ranked, got one that "
            f"plays {', '.join(submission.tasks)}. It is never in the ranking, so marks would not count.",
        )


def _require_whole(rubric: Judging, marks: Mapping[str, float]) -> None:
    names = [criterion.name for criterion in rubric.criteria]
    if set(marks) != set(names):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected a mark for each of {', '.join(names)}, got {', '.join(sorted(marks)) or 'none'}.",
        )
    for name, mark in marks.items():
        if not (isfinite(mark) and 0 <= mark <= BEST_MARK):
            raise ServiceError(ProblemCode.INVALID_REQUEST, f"Expected a mark from 0 to 10 for {name}, got {mark:g}.")


def _take_away(session: Session, judge: str, condition: ColumnElement[bool]) -> dict[str, object] | None:
    """Remove marks of a judge and return them for the audit log; None where there are none."""
    rows = session.execute(
        delete(JudgingMark)
        .where(JudgingMark.judge == judge, condition)
        .returning(JudgingMark.submission_id, JudgingMark.criterion, JudgingMark.mark)
    ).all()
    return {"judge": judge, "marks": {f"{row[0]}/{row[1]}": row[2] for row in rows}} if rows else None


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
