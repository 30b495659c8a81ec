"""Turns by which teams share the workers: one evaluation of each team, then the next of each; called at its start.

The start tags of start-time fair queueing, with evaluations of equal cost: P. Goyal, H. M. Vin and H. Cheng,
Start-time fair queuing, IEEE/ACM Transactions on Networking 5 (1997) 690-704, section 2.
"""

from uuid import UUID

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from ..database.models import Evaluation, Submission
from ..database.states import ACTIVE_EVALUATION_STATES, EvaluationState


def next_turn(session: Session, team_id: UUID) -> int:
    """Return the turn of a team's new evaluation: lower ones go first, of equal ones the earlier.

    It comes one after the team's last turn, but not before the turn that is running: who was away has saved nothing
    up, and who waits is not overtaken for ever. Two submissions of a team at the same moment may get the same turn.
    """
    of_team = Submission.team_id == team_id
    running, waiting, last_of_team = session.execute(
        select(
            func.max(Evaluation.turn).filter(Evaluation.state == EvaluationState.RUNNING),
            func.min(Evaluation.turn).filter(Evaluation.state == EvaluationState.QUEUED),
            func.max(Evaluation.turn).filter(of_team),
        )
        .join(Submission)
        .where(Evaluation.state.in_(ACTIVE_EVALUATION_STATES))
    ).one()
    now = next((turn for turn in (running, waiting) if turn is not None), 0)
    return now if last_of_team is None else max(now, last_of_team + 1)
