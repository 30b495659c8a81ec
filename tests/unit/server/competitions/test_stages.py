import threading
from datetime import datetime, timedelta

import pytest
from service_factories import (
    TASK,
    TRACK,
    claim,
    complete_scored,
    make_principal,
    make_record,
    make_score,
    make_upload,
    play_public_list,
    store,
    submit_scored,
)
from submission_steps import refused
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind
from vitac.server.accounts import teams
from vitac.server.accounts.quotas import stage_uses
from vitac.server.competitions import sealing
from vitac.server.competitions.competition import Competition
from vitac.server.database.engine import Database
from vitac.server.database.models import Qualification, Submission, Team
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import creation

from competitions import (
    CLOSES,
    FIRST,
    LATER_CLOSES,
    LATER_OPENS,
    OPENS,
    SECOND,
    make_competition,
    put_in_place,
    shown_stage,
    stored_stage,
)

MODEL = SubmissionKind.MODEL
SECOND_LONG = timedelta(seconds=1)
IN_FIRST, IN_SECOND = OPENS + timedelta(days=3), LATER_OPENS + timedelta(days=3)


@pytest.fixture
def principal(database: Database) -> Principal:
    with database.transaction() as session:
        put_in_place(session, make_competition())
        return make_principal(session)


def create(
    database: Database, by: Principal, at: datetime, content: str = "content", *, kind: SubmissionKind = MODEL
) -> Submission:
    with database.transaction() as session:
        team = "Team A" if by.organizes_service else None
        return creation.create(session, by, make_upload(content, kind=kind), team=team, at=at)[0]


def qualify(database: Database, principal: Principal) -> None:
    assert principal.team_id is not None
    with database.transaction() as session:
        session.add(Qualification(competition="cup", track=TRACK, stage=SECOND, team_id=principal.team_id))


@pytest.mark.parametrize(
    ("at", "stage"),
    [(OPENS, FIRST), (CLOSES - SECOND_LONG, FIRST), (LATER_OPENS, SECOND), (LATER_CLOSES - SECOND_LONG, SECOND)],
)
def test_a_submission_belongs_to_the_stage_that_is_open(
    database: Database, principal: Principal, at: datetime, stage: str
) -> None:
    qualify(database, principal)
    assert create(database, principal, at).stage == stage


@pytest.mark.parametrize(
    ("at", "said"),
    [
        (OPENS - SECOND_LONG, "stage stage1 opens at 2031-01-01 00:00:00 UTC"),
        (CLOSES, "stage stage2 opens at 2031-02-02 00:00:00 UTC"),
        (LATER_CLOSES, "its last stage closed at 2031-03-05 00:00:00 UTC"),
    ],
)
def test_outside_of_the_stages_a_submission_is_refused_with_the_next_moment(
    database: Database, principal: Principal, at: datetime, said: str
) -> None:
    with pytest.raises(ServiceError) as caught:
        create(database, principal, at)
    assert caught.value.code is ProblemCode.STAGE_CLOSED
    assert said in caught.value.detail


def test_organizers_submit_also_after_the_end_but_never_before_the_opening(
    database: Database, principal: Principal
) -> None:
    assert create(database, CONSOLE, CLOSES).stage == FIRST
    with refused(ProblemCode.STAGE_CLOSED):
        create(database, CONSOLE, OPENS - SECOND_LONG)


def test_a_published_list_is_scored_for_nobody(database: Database, principal: Principal) -> None:
    with database.transaction() as session:
        sealing.seal(session, CONSOLE, stored_stage(session, TRACK, SECOND))
        sealing.reveal(session, CONSOLE, stored_stage(session, TRACK, SECOND))
    qualify(database, principal)
    for by in (principal, CONSOLE):
        with refused(ProblemCode.STAGE_CLOSED):
            create(database, by, IN_SECOND)


def test_a_stage_takes_its_kinds_only(database: Database, principal: Principal) -> None:
    qualify(database, principal)
    with refused(ProblemCode.UNSUPPORTED_SUBMISSION_KIND):
        create(database, principal, IN_SECOND, kind=SubmissionKind.LOG)


def test_a_stage_for_qualified_teams_refuses_others_with_the_rule(database: Database, principal: Principal) -> None:
    with pytest.raises(ServiceError) as caught:
        create(database, principal, IN_SECOND)
    assert caught.value.code is ProblemCode.NOT_QUALIFIED
    assert "the best team of the stage before" in caught.value.detail


def test_the_same_content_is_another_submission_in_another_stage(database: Database, principal: Principal) -> None:
    qualify(database, principal)
    first = create(database, principal, IN_FIRST)
    assert create(database, principal, IN_FIRST + SECOND_LONG).id == first.id
    assert create(database, principal, IN_SECOND).id != first.id


def test_the_quota_of_a_stage_counts_what_is_or_may_be_scored(database: Database, principal: Principal) -> None:
    qualify(database, principal)
    one, two = (create(database, principal, IN_SECOND, content) for content in ("one", "two"))
    with pytest.raises(ServiceError) as caught:
        create(database, principal, IN_SECOND, "three")
    assert (caught.value.code, caught.value.extras["quota"]) == (ProblemCode.QUOTA_EXCEEDED, "stage_scored_runs")
    with database.transaction() as session:
        lifecycle.fail_by_machines(session, newest_evaluation(session, session.get_one(Submission, one.id)), "Lost.")
        lifecycle.cancel(session, newest_evaluation(session, session.get_one(Submission, two.id)))
    for content in ("three", "four"):
        create(database, principal, IN_SECOND, content)
    with refused(ProblemCode.QUOTA_EXCEEDED):
        create(database, principal, IN_SECOND, "five")


def test_a_run_that_saw_the_sealed_list_counts_also_where_it_was_cancelled(
    database: Database, principal: Principal
) -> None:
    qualify(database, principal)
    with database.transaction() as session:
        sealing.seal(session, CONSOLE, stored_stage(session, TRACK, SECOND))
    for content, sees in (("one", True), ("two", False), ("three", True)):
        found = create(database, principal, IN_SECOND, content)
        if sees:
            shard, *_ = play_public_list(database, found)
            store(database, claim(database, shard), [make_record(1)])
        with database.transaction() as session:
            lifecycle.cancel(session, newest_evaluation(session, session.get_one(Submission, found.id)))
    with refused(ProblemCode.QUOTA_EXCEEDED):
        create(database, principal, IN_SECOND, "four")


def test_of_many_submissions_at_once_a_stage_takes_as_many_as_its_quota(
    database: Database, principal: Principal
) -> None:
    qualify(database, principal)
    outcomes: list[str] = []

    def post(number: int) -> None:
        try:
            outcomes.append(create(database, principal, IN_SECOND, str(number)).stage)
        except ServiceError as error:
            outcomes.append(error.code)

    threads = [threading.Thread(target=post, args=(number,)) for number in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(outcomes) == ["quota_exceeded"] * 8 + [SECOND] * 2


def test_what_organizers_submit_costs_a_team_nothing_of_its_stage(database: Database, principal: Principal) -> None:
    qualify(database, principal)
    for number in range(3):
        create(database, CONSOLE, IN_SECOND, f"theirs {number}")
    create(database, principal, IN_SECOND, "own")


def test_a_disqualified_team_submits_nothing_anywhere(database: Database, principal: Principal) -> None:
    with database.transaction() as session:
        team = teams.own(session, principal)
        team.disqualified_at, team.disqualified_for = IN_FIRST, "two accounts"
    with pytest.raises(ServiceError, match="two accounts") as caught:
        create(database, principal, IN_FIRST)
    assert caught.value.code is ProblemCode.TEAM_DISQUALIFIED


def test_tracks_without_a_competition_are_open_for_practice(database: Database) -> None:
    with database.transaction() as session:
        team = make_principal(session)
        assert not Competition.read(session).is_held
        assert shown_stage(session, TRACK).is_practice
    assert create(database, team, IN_FIRST).stage == ""


def test_a_track_whose_submissions_are_collected_elsewhere_is_open_for_practice(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, make_competition(taken_here=False))
        team = make_principal(session)
        assert shown_stage(session, TRACK).is_practice
    assert create(database, team, LATER_CLOSES).stage == ""


@pytest.mark.parametrize(
    ("at", "stage"), [(OPENS - SECOND_LONG, FIRST), (CLOSES, FIRST), (LATER_OPENS, SECOND), (LATER_CLOSES, SECOND)]
)
def test_the_board_of_the_stage_that_opened_last_is_shown(
    database: Database, principal: Principal, at: datetime, stage: str
) -> None:
    with database.transaction() as session:
        competition = Competition.read(session)
        assert competition.shown_stage(TRACK, at=at).name == stage
        assert competition.shown_stage(TRACK, FIRST, at=at).name == FIRST
        with refused(ProblemCode.UNKNOWN_STAGE):
            competition.shown_stage(TRACK, "stage9")


def test_each_stage_has_its_board_and_disqualified_teams_are_on_none(database: Database, principal: Principal) -> None:
    qualify(database, principal)
    with database.transaction() as session:
        submit_scored(session, principal, "first", {TASK: make_score(50)}, at=IN_FIRST)
        other = make_principal(session, "Team B")
        submit_scored(session, other, "other", {TASK: make_score(40)}, at=IN_FIRST)
        final = creation.create(session, principal, make_upload("final", name="final"), at=IN_SECOND)[0]
        complete_scored(session, final, {TASK: make_score(30)})
    with database.transaction() as session:
        one, two = (shown_stage(session, TRACK, name) for name in (FIRST, SECOND))
        assert [entry.submission_name for entry in leaderboard(session, one).view.entries] == ["first", "other"]
        view = leaderboard(session, two).view
        assert [(entry.submission_name, view.stage) for entry in view.entries] == [("final", SECOND)]
        assert view.list_kind is ListKind.PUBLIC
        sealing.seal(session, CONSOLE, two)
        assert leaderboard(session, two).view.list_kind is ListKind.SEALED
        assert leaderboard(session, one).view.list_kind is ListKind.PUBLIC
        team = session.get_one(Team, principal.team_id)
        team.disqualified_at, team.disqualified_for = IN_SECOND, "two accounts"
        session.flush()
        assert [entry.submission_name for entry in leaderboard(session, one).view.entries] == ["other"]


def test_a_team_learns_what_it_may_still_have_in_the_open_stages(database: Database, principal: Principal) -> None:
    def uses(at: datetime) -> list[tuple[str, str, int | None, int]]:
        with database.transaction() as session:
            found = stage_uses(session, teams.own(session, principal), at)
        return [(use.stage, use.quota, use.limit, use.used) for use in found]

    assert uses(OPENS - SECOND_LONG) == uses(CLOSES) == []
    assert uses(IN_FIRST) == [(FIRST, "scored_runs", None, 0), (FIRST, "attempts", None, 0)]
    assert uses(IN_SECOND) == [], "it is not qualified"
    qualify(database, principal)
    create(database, principal, IN_SECOND)
    assert uses(IN_SECOND) == [(SECOND, "scored_runs", 2, 1), (SECOND, "attempts", None, 1)]
