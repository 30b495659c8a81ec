from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import pytest
from service_factories import (
    TASK,
    TRACK,
    complete_scored,
    make_principal,
    make_score,
    make_settings,
    submit,
    submit_scored,
)
from sqlalchemy import update
from sqlalchemy.orm import Session
from vitac.server.audit import newest_entries
from vitac.server.competitions import sealing
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow, Submission, Team
from vitac.server.database.states import EvaluationState, Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.public_pages import public_among, readable, set_public
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.submissions import listing, runs
from vitac.server.visibility import decide_sight

from competitions import make_competition, open_now, put_in_place, sealed_competition, stored_stage

SETTINGS = make_settings(database_url="postgresql:///elsewhere")
JUDGE = Principal(role=Role.JUDGE)


@dataclass(frozen=True, kw_only=True)
class Two:
    """Two teams, the first one with a complete submission."""

    session: Session
    owner: Principal
    other: Principal
    submission: Submission

    def publish(self, submission: Submission | None = None, *, public: bool = True) -> None:
        set_public(self.session, self.owner, (submission or self.submission).id, public=public)

    def seen_by(self, by: Principal, submission: Submission | None = None) -> ProblemCode | None:
        """None where the submission can be read, else the code of the refusal."""
        try:
            readable(self.session, by, (submission or self.submission).id)
        except ServiceError as refused:
            return refused.code
        return None


@pytest.fixture
def two(database: Database) -> Iterator[Two]:
    with database.transaction() as session:
        owner, other = make_principal(session), make_principal(session, "Team B")
        submission = submit_scored(session, owner, "good", {TASK: make_score(80)})
        yield Two(session=session, owner=owner, other=other, submission=submission)


def test_a_submission_is_its_teams_own_until_it_is_published(two: Two) -> None:
    assert two.seen_by(two.owner) is two.seen_by(JUDGE) is two.seen_by(CONSOLE) is None
    assert two.seen_by(two.other) is ProblemCode.NOT_FOUND
    assert two.seen_by(VISITOR) is ProblemCode.MISSING_CREDENTIALS
    two.publish()
    assert two.seen_by(two.other) is two.seen_by(VISITOR) is None
    two.publish(public=False)
    assert two.seen_by(two.other) is ProblemCode.NOT_FOUND
    assert two.seen_by(VISITOR) is ProblemCode.MISSING_CREDENTIALS


def test_publishing_is_noted_once_and_only_the_team_or_an_organizer_may(two: Two) -> None:
    two.publish()
    two.publish()
    set_public(two.session, CONSOLE, two.submission.id, public=False)
    two.session.flush()
    noted = newest_entries(two.session, subject=f"submission:{two.submission.id}")
    changes = [(entry.action, entry.before, entry.after) for entry in noted if "publish" in entry.action]
    assert changes == [
        ("submission.unpublish", {"public": True}, {"public": False}),
        ("submission.publish", {"public": False}, {"public": True}),
    ]
    for by, code in ((two.other, ProblemCode.NOT_FOUND), (JUDGE, ProblemCode.FORBIDDEN)):
        with pytest.raises(ServiceError) as refused:
            set_public(two.session, by, two.submission.id, public=True)
        assert refused.value.code is code


def test_what_waits_or_has_failed_is_shown_to_nobody_else(two: Two) -> None:
    waiting = submit(two.session, two.owner, "next")
    two.publish(waiting)
    assert two.seen_by(VISITOR, waiting) is ProblemCode.MISSING_CREDENTIALS
    two.publish()
    runs.run_again(two.session, CONSOLE, two.submission.id)
    assert two.seen_by(VISITOR) is ProblemCode.MISSING_CREDENTIALS
    assert public_among(two.session, [two.submission.id, waiting.id]) == frozenset()
    runs.cancel(two.session, two.owner, two.submission.id)
    assert newest_evaluation(two.session, two.submission).state is EvaluationState.CANCELLED
    assert two.seen_by(two.other) is ProblemCode.NOT_FOUND


def test_others_see_the_score_and_episodes_but_no_output_and_no_earlier_runs(two: Two) -> None:
    two.publish()
    runs.run_again(two.session, CONSOLE, two.submission.id)
    complete_scored(two.session, two.submission, {TASK: make_score(70)})
    evaluation = newest_evaluation(two.session, two.submission)
    evaluation.log_tail = "a secret of the team"
    two.session.flush()
    own = listing.get(two.session, SETTINGS, two.owner, two.submission.id)
    shown = listing.get(two.session, SETTINGS, VISITOR, two.submission.id)
    assert own.public
    assert shown.public
    assert (own.evaluation.log_tail, shown.evaluation.log_tail) == ("a secret of the team", "")
    assert (len(own.evaluations), len(shown.evaluations)) == (2, 1)
    assert shown.evaluation.success_rate == own.evaluation.success_rate
    assert shown.evaluation.differing_episodes is None
    assert decide_sight(VISITOR, evaluation).episodes
    assert not decide_sight(two.other, evaluation).output
    assert decide_sight(two.owner, evaluation).output


def test_disqualified_teams_and_results_that_frozen_boards_do_not_show_are_left_out(two: Two) -> None:
    put_in_place(two.session, open_now(make_competition()))
    staged = submit_scored(two.session, two.owner, "staged", {TASK: make_score(90)})
    for submission in (two.submission, staged):
        two.publish(submission)
    both = [two.submission.id, staged.id]
    assert public_among(two.session, both) == frozenset(both)
    cup = two.session.get_one(CompetitionRow, "cup")
    cup.frozen_at = datetime.now(UTC) - timedelta(hours=1)
    two.session.flush()
    assert public_among(two.session, both) == {two.submission.id}, "outside of the competition nothing stands still"
    assert two.seen_by(two.other, staged) is ProblemCode.NOT_FOUND
    cup.frozen_at = datetime.now(UTC) + timedelta(seconds=1)
    two.session.flush()
    assert public_among(two.session, both) == frozenset(both)
    two.session.execute(update(Team).values(disqualified_at=datetime.now(UTC), disqualified_for="copied"))
    assert public_among(two.session, both) == frozenset()
    assert public_among(two.session, []) == frozenset()


def test_a_stage_may_make_results_public_and_a_team_takes_its_own_back(two: Two) -> None:
    content = open_now(make_competition())
    put_in_place(two.session, content)
    assert not submit(two.session, two.owner, "before").is_public
    content["tracks"][TRACK]["stages"][0]["public_pages"] = True
    put_in_place(two.session, content)
    after = submit(two.session, two.owner, "after")
    assert after.is_public
    two.publish(after, public=False)
    assert not submit(two.session, two.owner, "after").is_public, "uploading it again changes nothing"
    assert not submit(two.session, two.owner, "before").is_public


def test_of_a_sealed_list_others_see_the_final_score_only(two: Two) -> None:
    put_in_place(two.session, open_now(sealed_competition()))
    sealing.seal(two.session, CONSOLE, stored_stage(two.session, TRACK, "stage1"))
    sealed = submit_scored(two.session, two.owner, "sealed", {TASK: make_score(90)})
    two.publish(sealed)
    for by in (VISITOR, two.other, two.owner):
        shown = listing.get(two.session, SETTINGS, by, sealed.id)
        assert shown.evaluation.episodes_hidden
        assert shown.evaluation.success_rate is not None
        assert not listing.episodes(two.session, by, sealed.id)
