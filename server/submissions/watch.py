"""Follows a submission until its evaluation has ended; called by the event stream of the API."""

import asyncio
from collections.abc import AsyncGenerator
from uuid import UUID

from ..db.engine import Database
from ..db.states import TERMINAL_EVALUATION_STATES
from ..principals import Principal
from ..settings import Settings
from ..views.submissions import SubmissionView
from .listing import get

WATCH_INTERVAL_S = 0.5


async def watch(
    database: Database, settings: Settings, by: Principal, submission_id: UUID
) -> AsyncGenerator[SubmissionView, None]:
    """Yield the submission now and after each change, until its evaluation has ended.

    Raises:
        ServiceError: there is no such submission.
    """

    def look() -> SubmissionView:
        with database.transaction() as session:
            return get(session, settings, by, submission_id)

    last = None
    while True:
        view = await asyncio.to_thread(look)
        if view != last:
            yield view
        if view.evaluation.state in TERMINAL_EVALUATION_STATES:
            return
        last = view
        await asyncio.sleep(WATCH_INTERVAL_S)
