from collections.abc import Callable
from datetime import UTC, datetime

import pytest
from service_factories import (
    TASK,
    TRACK,
    complete_scored,
    make_principal,
    make_score,
    make_upload,
    outdate,
    submit_scored,
)
from sqlalchemy.orm import Session
from submission_steps import refused
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow, Submission, Team
from vitac.server.decisions.advancement import confirm
from vitac.server.decisions.finishing import finalize
from vitac.server.errors import ProblemCode
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE
from vitac.server.submissions import creation, runs

from competitions import FIRST, SECOND, make_competition, moved, put_in_place, stored_stage

AT = datetime(2031, 1, 3, tzinfo=UTC)
Decision = Callable[[Session], object]


def advance(session: Session) -> object:
    return confirm(session, CONSOLE, stored_stage(session, TRACK, SECOND))


@pytest.fixture
def submissions(database: Database) -> dict[str, Submission]:
    """A stage that is over with two models of Ants, and one of Bees that machines failed."""
    with database.transaction() as session:
        put_in_place(session, make_competition())
        ants, bees = (make_principal(session, name) for name in ("Ants", "Bees"))
        made = {
            name: submit_scored(session, ants, name, {TASK: make_score(successes)}, at=AT)
            for name, successes in (("good", 50), ("better", 60))
        }
        made["lost"] = creation.create(session, bees, make_upload("lost"), at=AT)[0]
        lifecycle.fail_by_machines(session, newest_evaluation(session, made["lost"]), "Lost.")
        put_in_place(session, moved(make_competition(), days=-3650))
    return made


def requeue(database: Database, submission: Submission, *, successes: int | None = None) -> None:
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
        if successes is None:
            runs.cancel(session, CONSOLE, submission.id)
        else:
            complete_scored(session, session.get_one(Submission, submission.id), {TASK: make_score(successes)})


@pytest.mark.parametrize("decide", [advance, lambda session: finalize(session, CONSOLE)], ids=["advance", "finalize"])
def test_what_machines_lost_is_decided_before_anything_else(
    database: Database, submissions: dict[str, Submission], decide: Decision
) -> None:
    with refused(ProblemCode.STAGE_NOT_OVER), database.transaction() as session:
        decide(session)
    requeue(database, submissions["lost"])
    with database.transaction() as session:
        decide(session)


def test_one_stale_result_of_a_team_with_a_current_one_stops_the_advancement(
    database: Database, submissions: dict[str, Submission]
) -> None:
    requeue(database, submissions["lost"])
    with database.transaction() as session:
        outdate(session)
    requeue(database, submissions["good"], successes=50)
    with refused(ProblemCode.RESULTS_OUTDATED), database.transaction() as session:
        advance(session)
    requeue(database, submissions["better"], successes=40)
    with database.transaction() as session:
        assert advance(session) == ["Ants"]


def test_stale_results_of_the_last_stage_stop_the_end(database: Database, submissions: dict[str, Submission]) -> None:
    requeue(database, submissions["lost"])
    one_stage = moved(make_competition(), days=-3650)
    del one_stage["tracks"][TRACK]["stages"][1]
    with database.transaction() as session:
        put_in_place(session, one_stage)
        outdate(session)
    requeue(database, submissions["good"], successes=50)
    with refused(ProblemCode.RESULTS_OUTDATED), database.transaction() as session:
        finalize(session, CONSOLE)
    with database.transaction() as session:
        assert session.get_one(CompetitionRow, "cup").finalized_at is None


def test_a_disqualified_team_holds_nobody_up(database: Database, submissions: dict[str, Submission]) -> None:
    with database.transaction() as session:
        assert submissions["lost"].stage == FIRST
        team = session.get_one(Team, submissions["lost"].team_id)
        team.disqualified_at, team.disqualified_for = AT, "two accounts"
    with database.transaction() as session:
        assert advance(session) == ["Ants"]
