from service_factories import TASK, complete_scored, make_score
from sqlalchemy import text
from submission_steps import create, refused, view_of
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import runs


def test_a_finished_submission_is_not_cancelled_and_run_again_by_organizers_which_the_log_says(
    database: Database, principal: Principal
) -> None:
    submission, _ = create(database, principal)
    with refused(ProblemCode.NOT_REQUEUABLE), database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
    with database.transaction() as session:
        complete_scored(session, session.get_one(Submission, submission.id), {TASK: make_score(50)})
    with refused(ProblemCode.NOT_CANCELLABLE), database.transaction() as session:
        runs.cancel(session, principal, submission.id)
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        runs.run_again(session, principal, submission.id)
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
    assert view_of(database, principal, submission).evaluation.run == 2
    with database.transaction() as session:
        lines = session.execute(text("SELECT actor, action FROM audit_log ORDER BY id")).all()
    assert ("organizer:console", "submission.requeue") in lines
    assert ("team:Team A", "submission.evaluate") in lines
