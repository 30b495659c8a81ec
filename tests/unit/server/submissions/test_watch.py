import asyncio
from uuid import UUID

import pytest
from service_factories import (
    play_all,
)
from submission_steps import SETTINGS, create
from vitac.server.database.engine import Database
from vitac.server.database.states import EvaluationState
from vitac.server.principals import Principal
from vitac.server.submissions import watch as watching
from vitac.server.submissions.watch import SubmissionWatch, Watched, watch


def test_watching_gives_each_change_and_ends_with_the_evaluation(
    database: Database, principal: Principal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watching, "LOOK_AGAIN_S", 3600.0)  # the database tells
    submission, _ = create(database, principal)

    async def follow() -> list[EvaluationState]:
        changes = SubmissionWatch()
        async with changes.listening(database.address):
            return await asyncio.wait_for(followed(changes), 60.0)

    async def followed(changes: SubmissionWatch) -> list[EvaluationState]:
        states = []
        async for view in watch(database, SETTINGS, principal, submission.id, changes):
            if view.evaluation.state not in states:
                states.append(view.evaluation.state)
            if len(states) == 1 and view.evaluation.progress.episodes_done == 0:
                await asyncio.to_thread(play_all, database, submission)
        return states

    states = asyncio.run(follow())
    assert states[0] is EvaluationState.QUEUED
    assert states[-1] is EvaluationState.COMPLETED


def test_all_of_an_account_share_each_look_at_a_submission(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "PAUSE_S", 0.0)
    looks: list[int] = []

    async def make() -> int:
        looks.append(1)
        await asyncio.sleep(0)
        return len(looks)

    async def follow(watched: Watched) -> list[int]:
        seen, first = watched.version, await watched.look("Ants", make)
        await watched.wait(seen)
        return [first, await watched.look("Ants", make)]

    async def follow_all() -> None:
        changes = SubmissionWatch()
        with changes.of(UUID(int=1)) as watched, changes.of(UUID(int=1)) as same:
            assert same is watched
            following = [asyncio.create_task(follow(watched)) for _ in range(100)]
            while len(looks) < 1 or not all(task.get_stack() for task in following):
                await asyncio.sleep(0)
            for _ in range(5):
                await asyncio.sleep(0)
            watched.change()
            assert await asyncio.gather(*following) == [[1, 2]] * 100
        assert not changes._watched

    asyncio.run(follow_all())
