from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from quota_clock import QuotaClock
from service_factories import make_principal, play_all
from sqlalchemy import delete, select, update
from submission_steps import break_policy, create, refused
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts import quotas, teams
from vitac.server.database.engine import Database
from vitac.server.database.models import AuditEntry, Evaluation, PartialUpload, Submission
from vitac.server.database.states import Quota
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import FREE_FAILURES_PER_DAY, fail_by_machines
from vitac.server.principals import CONSOLE, Principal
from vitac.server.settings import Quotas, load_settings
from vitac.server.submissions import partial_uploads, runs
from vitac.server.submissions.files import stored_digests
from vitac.server.submissions.intake import AnnouncedUpload

pytestmark = pytest.mark.usefixtures("quota_clock")


def submit(database: Database, principal: Principal, content: str, **limits: int) -> Submission:
    return create(database, principal, content, quotas=Quotas(**limits))[0]


def used(database: Database, principal: Principal) -> dict[str, Any]:
    assert principal.team_id is not None
    with database.transaction() as session:
        return {use.quota.value: use.used for use in quotas.uses(session, Quotas(), principal.team_id)}


def fail_machines(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        fail_by_machines(session, newest_evaluation(session, submission), "They were lost.")


@pytest.mark.parametrize("quota", ["scored_runs_per_day", "attempts_per_day", "queued_at_once"])
def test_one_evaluation_more_than_a_quota_is_refused_by_its_name(
    database: Database, principal: Principal, quota: str
) -> None:
    submit(database, principal, "one", **{quota: 1})
    with pytest.raises(ServiceError) as caught:
        submit(database, principal, "two", **{quota: 1})
    error = caught.value
    assert error.code is ProblemCode.QUOTA_EXCEEDED
    assert (error.extras["quota"], error.extras["limit"]) == (quota, 1)
    assert quota in error.detail
    with database.transaction() as session:
        assert len(session.scalars(select(Submission)).all()) == 1


def test_stored_uploads_count_each_file_once_until_a_day_after_a_cancel(
    database: Database, principal: Principal
) -> None:
    one = submit(database, principal, "one")
    with database.transaction() as session:
        session.execute(update(Submission).values(archive_bytes=5 << 20))
        team = teams.own(session, principal)
        announced = AnnouncedUpload(kind=SubmissionKind.MODEL, total_bytes=3 << 20)
        partial_uploads.begin_resumable(session, load_settings(), team, announced)
    assert used(database, principal)["stored_mib"] == 8
    with pytest.raises(ServiceError, match="quota stored_mib"):
        submit(database, principal, "two", stored_mib=8)
    with database.transaction() as session:
        runs.cancel(session, principal, one.id)
    assert used(database, principal)["stored_mib"] == 8
    with database.transaction() as session:
        session.execute(update(Evaluation).values(finished_at=datetime.now(UTC) - timedelta(days=2)))
        session.execute(delete(PartialUpload))
    assert used(database, principal)["stored_mib"] == 0
    with database.transaction() as session:
        assert one.archive_sha256 not in stored_digests(session)
        with refused(ProblemCode.NOT_REQUEUABLE):
            runs.run_again(session, CONSOLE, one.id)


def test_attempts_and_bytes_of_a_team_are_bounded_without_a_setting() -> None:
    defaults = Quotas()
    assert None not in {defaults.attempts_per_day, defaults.queued_at_once, defaults.stored_mib}


def test_a_daily_quota_says_when_it_opens_and_opens_then(
    database: Database, principal: Principal, quota_clock: QuotaClock
) -> None:
    midnight = quota_clock.midnight
    quota_clock.moment = midnight - timedelta(microseconds=1)
    first = submit(database, principal, "one", attempts_per_day=1)
    with pytest.raises(ServiceError) as caught:
        submit(database, principal, "two", attempts_per_day=1)
    assert caught.value.extras["opens_at"] == midnight.isoformat()
    assert f"{midnight:%F} 00:00 UTC" in caught.value.detail
    assert used(database, principal)["attempts_per_day"] == 1
    quota_clock.moment = midnight
    counts = used(database, principal)
    assert (counts["attempts_per_day"], counts["scored_runs_per_day"], counts["queued_at_once"]) == (0, 0, 1)
    assert submit(database, principal, "two", attempts_per_day=1).id != first.id


def test_the_first_moment_of_a_day_counts_for_it(
    database: Database, principal: Principal, quota_clock: QuotaClock
) -> None:
    first_moment = quota_clock.moment = quota_clock.midnight
    submit(database, principal, "one")
    quota_clock.moment = quota_clock.midnight - timedelta(microseconds=1)
    assert quota_clock.moment.date() == first_moment.date()
    assert used(database, principal)["attempts_per_day"] == 1


def test_scored_runs_and_attempts_are_counted_apart(database: Database, principal: Principal) -> None:
    broken, done, cancelled = (submit(database, principal, name) for name in ("broken", "done", "cancelled"))
    assert used(database, principal) == {
        "scored_runs_per_day": 3,
        "attempts_per_day": 3,
        "queued_at_once": 3,
        "stored_mib": 1,
        "tokens": 0,
        "event_streams": None,
    }
    break_policy(database, broken)
    play_all(database, done)
    with database.transaction() as session:
        runs.cancel(session, principal, cancelled.id)
    counts = used(database, principal)
    assert (counts["scored_runs_per_day"], counts["attempts_per_day"], counts["queued_at_once"]) == (1, 3, 0)


def test_what_machines_failed_costs_nothing(database: Database, principal: Principal) -> None:
    submission = submit(database, principal, "one", scored_runs_per_day=1, attempts_per_day=1, queued_at_once=1)
    fail_machines(database, submission)
    assert used(database, principal)["attempts_per_day"] == 0
    again = submit(database, principal, "one", scored_runs_per_day=1, attempts_per_day=1, queued_at_once=1)
    assert again.id == submission.id
    assert used(database, principal)["attempts_per_day"] == 1


def test_after_so_many_failures_of_the_machines_within_a_day_they_cost_an_attempt_each(
    database: Database, principal: Principal
) -> None:
    """A team that makes machines fail with one submission after the other comes to the end of its quota."""
    for number in range(FREE_FAILURES_PER_DAY + 2):
        fail_machines(database, submit(database, principal, f"content {number}"))
    counts = used(database, principal)
    assert (counts["attempts_per_day"], counts["scored_runs_per_day"], counts["queued_at_once"]) == (2, 0, 0)
    with refused(ProblemCode.QUOTA_EXCEEDED):
        submit(database, principal, "another", attempts_per_day=2)
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    fail_machines(database, submit(database, other, "content"))
    assert used(database, other)["attempts_per_day"] == 0
    with database.transaction() as session:
        session.execute(update(Evaluation).values(finished_at=datetime.now(UTC) - timedelta(hours=25)))
    fail_machines(database, submit(database, principal, "the day after"))
    assert used(database, principal)["attempts_per_day"] == 2


def test_what_organizers_start_costs_nothing(database: Database, principal: Principal) -> None:
    submission = submit(database, principal, "one", attempts_per_day=1)
    play_all(database, submission)
    with database.transaction() as session:
        runs.run_again(session, CONSOLE, submission.id)
    create(database, CONSOLE, "two", team="Team A", quotas=Quotas(attempts_per_day=1))
    assert used(database, principal)["attempts_per_day"] == 1


def test_content_that_is_evaluated_already_is_answered_whatever_the_quota(
    database: Database, principal: Principal
) -> None:
    first = submit(database, principal, "one", attempts_per_day=1)
    assert submit(database, principal, "one", attempts_per_day=1).id == first.id


def test_quotas_of_one_team_are_not_those_of_another(database: Database, principal: Principal) -> None:
    submit(database, principal, "one", attempts_per_day=1)
    with database.transaction() as session:
        other = make_principal(session, "Team B")
    submit(database, other, "one", attempts_per_day=1)


def test_a_team_may_have_a_limit_of_its_own_until_it_is_reset(database: Database, principal: Principal) -> None:
    def set_own(limit: int | None) -> None:
        with database.transaction() as session:
            quotas.set_quota(session, CONSOLE, teams.own(session, principal), Quota.ATTEMPTS_PER_DAY, limit)

    set_own(0)
    with refused(ProblemCode.QUOTA_EXCEEDED):
        submit(database, principal, "one")
    set_own(None)
    for content in ("one", "two"):
        submit(database, principal, content, attempts_per_day=1)
    with database.transaction() as session:
        quotas.reset_quota(session, CONSOLE, teams.own(session, principal), Quota.ATTEMPTS_PER_DAY)
    with refused(ProblemCode.QUOTA_EXCEEDED):
        submit(database, principal, "three", attempts_per_day=1)
    with database.transaction() as session:
        noted = session.scalars(select(AuditEntry).where(AuditEntry.action == "team.quota").order_by(AuditEntry.id))
        limits = [((entry.before or {})["limit"], entry.after["limit"]) for entry in noted]
    assert limits == [("default", 0), (0, None), (None, "default")]


def test_a_team_cannot_change_its_quotas(database: Database, principal: Principal) -> None:
    with database.transaction() as session, refused(ProblemCode.FORBIDDEN):
        quotas.set_quota(session, principal, teams.own(session, principal), Quota.TOKENS, None)
