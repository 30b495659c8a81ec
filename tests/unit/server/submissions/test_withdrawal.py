"""A team takes back what it submitted, or deletes it: boards, quotas, files and what others see."""

from collections.abc import Callable
from uuid import UUID

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, make_upload, submit, submit_scored
from sqlalchemy import select
from sqlalchemy.orm import Session
from submission_steps import SETTINGS, refused
from vitac.server.accounts.quotas import uses
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow, Submission
from vitac.server.database.states import EvaluationState, Quota, Role
from vitac.server.errors import ProblemCode
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.public_pages import public_among
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import creation, listing, withdrawal
from vitac.server.submissions.files import stored_digests

from competitions import make_competition, open_now, put_in_place, shown_stage

CHANGES: list[Callable[[Session, Principal, UUID], None]] = [
    withdrawal.withdraw, withdrawal.restore, withdrawal.erase
]  # fmt: skip


def on_board(session: Session) -> list[str]:
    session.flush()
    return [
        entry.submission_name for entry in leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
    ]


def test_a_withdrawn_submission_leaves_the_board_to_the_next_of_its_team_until_it_is_put_back(
    database: Database,
) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        best = submit_scored(session, ants, "best", {TASK: make_score(90)})
        submit_scored(session, ants, "second", {TASK: make_score(40)})
        best.is_public = True
        used = uses(session, SETTINGS.quotas, best.team_id)
        for _ in range(2):
            withdrawal.withdraw(session, ants, best.id)
        assert on_board(session) == ["second"]
        assert not public_among(session, [best.id])
        assert listing.get(session, SETTINGS, ants, best.id).withdrawn_at is not None
        assert uses(session, SETTINGS.quotas, best.team_id) == used, "what it used stays used"
        assert [entry.action for entry in newest_entries(session, 1)] == ["submission.withdraw"]
        withdrawal.restore(session, ants, best.id)
        assert on_board(session) == ["best"]
        withdrawal.withdraw(session, ants, best.id)
        withdrawal.disqualify(session, CONSOLE, best.id, "copied")
        withdrawal.restore(session, ants, best.id)
        assert on_board(session) == ["second"], "an organizer's decision stays"


def test_what_runs_of_a_withdrawn_submission_is_cancelled_and_the_same_content_puts_it_back(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        waits = submit(session, ants, "waits")
        withdrawal.withdraw(session, ants, waits.id)
        assert newest_evaluation(session, waits).state is EvaluationState.CANCELLED
    with database.transaction() as session:
        again = submit(session, ants, "waits")
        assert (again.id, again.withdrawn_at) == (waits.id, None)
        assert newest_evaluation(session, again).state is EvaluationState.QUEUED


def test_a_deleted_submission_has_no_upload_and_keeps_its_scores(database: Database) -> None:
    with database.transaction() as session:
        ants = make_principal(session, "Ants")
        best = submit_scored(session, ants, "best", {TASK: make_score(90)})
        best.description = {"text": "Ours."}
        stored = {use.quota: use.used or 0 for use in uses(session, SETTINGS.quotas, best.team_id)}
        for _ in range(2):
            withdrawal.erase(session, ants, best.id)
        session.flush()
        assert on_board(session) == []
        assert best.archive_sha256 not in stored_digests(session)
        view = listing.get(session, SETTINGS, ants, best.id)
        assert (view.deleted_at is not None, view.evaluation.success_rate is not None) == (True, True)
        assert (view.description and view.description.text) is None
        now = {use.quota: use.used or 0 for use in uses(session, SETTINGS.quotas, best.team_id)}
        assert now[Quota.STORED_MIB] <= stored[Quota.STORED_MIB]
        assert now[Quota.ATTEMPTS_PER_DAY] == stored[Quota.ATTEMPTS_PER_DAY]
        with refused(ProblemCode.INVALID_REQUEST):
            withdrawal.restore(session, ants, best.id)
    with database.transaction() as session:
        upload = make_upload("best", name="best", tasks=(TASK,))
        again, is_new = creation.create(session, ants, upload)
        session.flush()
        assert (again.id, is_new, again.erased_at) == (best.id, False, None)
        assert again.archive_sha256 in stored_digests(session)
        assert on_board(session) == ["best"]


@pytest.mark.parametrize("change", CHANGES)
def test_only_the_team_and_organizers_take_it_back_and_not_after_the_end(
    database: Database, change: Callable[[Session, Principal, UUID], None]
) -> None:
    with database.transaction() as session:
        put_in_place(session, open_now(make_competition()))
        ants, bees = (make_principal(session, name) for name in ("Ants", "Bees"))
        best = submit_scored(session, ants, "best", {TASK: make_score(90)})
        with refused(ProblemCode.NOT_FOUND):
            change(session, bees, best.id)
        with refused(ProblemCode.FORBIDDEN):
            change(session, Principal(role=Role.JUDGE), best.id)
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners, row.boards = best.submitted_at, [], []
        session.flush()
        with refused(ProblemCode.COMPETITION_FINAL):
            change(session, ants, best.id)
        assert session.scalar(select(Submission.withdrawn_at)) is None
