"""Results of attempts that were played elsewhere, as on a robot, entered by operators with their evidence.

The score of an attempt is the sum over the stage's tasks, all of the same attempt; a team's best attempt counts.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from uuid import UUID

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from ..accounts import teams
from ..accounts.shown_names import ShownNames
from ..audit import record
from ..competitions.competition import Competition
from ..competitions.definition import EnteredTask
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import EnteredResult, Team
from ..errors import ProblemCode, ServiceError
from ..principals import VISITOR, Principal
from ..submissions.briefs import is_accepted
from ..views.by_hand import EnteredBoardView, EnteredEntryView, EnteredTaskView


def enter(
    session: Session,
    by: Principal,
    stage: Stage,
    *,
    team: str | None,
    baseline: str | None,
    attempt: int,
    points: Mapping[str, float],
    evidence: str,
) -> EnteredResult:
    """Store the points of an attempt, in place of what was entered of it before.

    Args:
        session: of the transaction.
        by: an organizer.
        stage: which one.
        team: name or id.
        baseline: in place of a team: name of a policy of the organizers', which is shown without a rank.
        attempt: of the team, from 1.
        points: of every task of the stage.
        evidence: what shows it, such as the address of a film and its SHA-256.

    Raises:
        ServiceError: not an organizer, the stage has no such results, it has not opened, the competition is final, the
            team is unknown or did not advance, or points are missing or out of range.
    """
    by.require_organizer(stage.competition)
    competition = Competition.lock(session, stage.competition)
    competition.require_not_final()
    tasks = _require_tasks(stage)
    if read_clock(session) < stage.rules.opens:
        raise ServiceError(ProblemCode.STAGE_CLOSED, f"Stage {stage.name} opens at {stage.rules.opens:%F %T} UTC.")
    if (team is None) == (baseline is None):
        raise ServiceError(ProblemCode.INVALID_REQUEST, "Expected the name of a team or of a baseline, one of both.")
    player = None if team is None else _find_taking_part(session, stage, team)
    _require_whole(tasks, points)
    row = session.scalar(
        _of_stage(stage).where(
            EnteredResult.team_id == (player.id if player else None),
            EnteredResult.baseline == baseline,
            EnteredResult.attempt == attempt,
        )
    )
    before = None if row is None else {"points": row.points, "evidence": row.evidence}
    if row is None:
        row = EnteredResult(**stage.place, team=player, baseline=baseline, attempt=attempt)
        session.add(row)
    row.points, row.evidence, row.entered_by = dict(points), evidence, by.actor
    session.flush()
    after = {"player": player.name if player else baseline, "attempt": attempt, "points": dict(points)}
    record(session, by, "result.enter", stage.subject, after | {"evidence": evidence}, before=before)
    return row


def board(session: Session, stage: Stage, by: Principal = VISITOR) -> EnteredBoardView:
    """Return the best attempts of a stage: the largest sum first, of equal ones the one that was entered first.

    Raises:
        ServiceError: its results are not entered.
    """
    tasks, names = _require_tasks(stage), ShownNames.read(session, by)
    ordered = best_attempts(session, stage)
    ranks = {row.team: rank for rank, row in enumerate((row for row, _ in ordered if row.team), 1)}
    is_last = stage.track_rules.stages[-1].name == stage.name
    prizes = stage.track_rules.single_prizes if is_last and stage.is_over(read_clock(session)) else ()
    return EnteredBoardView(
        **stage.place,
        tasks=[EnteredTaskView(**task.model_dump()) for task in tasks],
        entries=[
            EnteredEntryView.from_row(
                row,
                rank=ranks.get(row.team),
                team=names.show_name(row.team) if row.team is not None else row.baseline or "",
                is_baseline=row.team is None,
                attempts=attempts,
                points={task.name: row.points.get(task.name, 0) for task in tasks},
                total=total(stage, row),
                prize=prizes[ranks[row.team] - 1].place if 0 < ranks.get(row.team, 0) <= len(prizes) else None,
            )
            for row, attempts in ordered
        ],
    )


def best_attempts(session: Session, stage: Stage) -> Sequence[tuple[EnteredResult, int]]:
    """Return the best attempt of each player that is not disqualified, and how many it had, in the board's order."""
    best: dict[UUID | str | None, EnteredResult] = {}
    attempts: Counter[UUID | str | None] = Counter()
    for row in session.scalars(_of_stage(stage).order_by(EnteredResult.entered_at, EnteredResult.id)):
        if row.team is not None and row.team.disqualified_at is not None:
            continue
        player = row.team_id or row.baseline
        attempts[player] += 1
        if player not in best or total(stage, row) > total(stage, best[player]):
            best[player] = row
    ordered = sorted(best.items(), key=lambda item: -total(stage, item[1]))
    return [(row, attempts[player]) for player, row in ordered]


def total(stage: Stage, row: EnteredResult) -> float:
    """Return the sum over the stage's tasks of an attempt."""
    return float(sum(row.points.get(task.name, 0) for task in stage.rules.entered))


def _of_stage(stage: Stage) -> Select[EnteredResult]:
    return select(EnteredResult).where(*stage.make_rows(EnteredResult))


def _find_taking_part(session: Session, stage: Stage, name: str) -> Team:
    team = teams.find(session, name)
    teams.require_taking_part(team)
    rule = stage.rules.qualified
    is_chosen = rule and rule.committee and stage.before and is_accepted(session, stage.before, team.id)
    if not (is_chosen or stage.may_submit(team)):
        raise ServiceError(
            ProblemCode.NOT_QUALIFIED,
            f"{team.name} takes no part in stage {stage.name}: it is for {rule.sentence if rule else 'all'}.",
        )
    return team


def _require_tasks(stage: Stage) -> tuple[EnteredTask, ...]:
    if not stage.rules.entered:
        raise ServiceError(
            ProblemCode.UNKNOWN_STAGE, f"Results of stage {stage.name} of {stage.track} are not entered."
        )
    return stage.rules.entered


def _require_whole(tasks: Sequence[EnteredTask], points: Mapping[str, float]) -> None:
    names = ", ".join(task.name for task in tasks)
    if points.keys() != {task.name for task in tasks}:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected points of {names}, got {', '.join(map(repr, points)) or 'none'}."
        )
    for task in tasks:
        if not 0 <= points[task.name] <= task.points:
            raise ServiceError(
                ProblemCode.INVALID_REQUEST,
                f"Expected points of {task.name} from 0 to {task.points}, got {points[task.name]:g}.",
            )
