import asyncio

from service_factories import (
    play_all,
)
from submission_steps import SETTINGS, create
from vitac.server.db.engine import Database
from vitac.server.db.states import EvaluationState
from vitac.server.principals import Principal
from vitac.server.submissions.watch import watch


def test_watching_gives_each_change_and_ends_with_the_evaluation(database: Database, principal: Principal) -> None:
    submission, _ = create(database, principal)

    async def follow() -> list[EvaluationState]:
        states = []
        async for view in watch(database, SETTINGS, principal, submission.id):
            if view.evaluation.state not in states:
                states.append(view.evaluation.state)
            if len(states) == 1 and view.evaluation.progress.episodes_done == 0:
                await asyncio.to_thread(play_all, database, submission)
        return states

    states = asyncio.run(follow())
    assert states[0] is EvaluationState.QUEUED
    assert states[-1] is EvaluationState.COMPLETED
