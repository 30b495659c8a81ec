from datetime import timedelta

import pytest
from service_factories import (
    TASK,
    TRACK,
    make_principal,
    make_score,
    make_secret,
    submit,
    submit_scored,
)
from sqlalchemy import select
from submission_steps import refused
from vitac.server.accounts import members, merging, outbox, teams, tokens
from vitac.server.accounts.members import JoiningMember
from vitac.server.accounts.quotas import uses
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import JudgingConflict, Notice, Qualification, Submission, Team
from vitac.server.database.states import MemberRole, NoticeKind, Quota
from vitac.server.errors import ProblemCode
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.operations import team_data
from vitac.server.principals import CONSOLE
from vitac.server.settings import Quotas

from competitions import shown_stage, stored_stage, teams_on_board


def test_a_merge_keeps_submissions_members_tokens_and_places_and_counts_quotas_together(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        secret = make_secret(session, ants)
        best = submit_scored(session, ants, "best", {TASK: make_score(90)}).id
        submit_scored(session, bees, "worse", {TASK: make_score(10)})
        both = [submit(session, team, "the same").id for team in (ants, bees)]
        session.add(Qualification(competition="", track=TRACK, stage="stage2", team_id=ants.team_id))
        old, new = teams.own(session, ants), teams.own(session, bees)
        _, code = members.invite(session, ants, old)
        members.join(session, JoiningMember(code=code, name="Ann"), timedelta(days=1))
        assert teams_on_board(session, task=TASK) == ["Ants", "Bees"]
        merging.merge(session, CONSOLE, old, new)
    with database.transaction() as session:
        assert session.get(Team, ants.team_id) is None
        left = teams.find(session, "Bees")
        assert {row.team_id for row in session.query(Submission)} == {left.id}
        assert [session.get_one(Submission, one).merged_from for one in both] == [ants.team_id, None]
        assert submit(session, bees, "the same").id == both[1]
        (entry,) = leaderboard(session, shown_stage(session, TRACK), task=TASK).view.entries
        assert (entry.team, entry.submission_id) == ("Bees", best)
        people = members.list_team_members(session, left.id)
        assert sorted(one.name for one in people) == ["Ann", "Captain", "Captain 2"]
        assert [one.name for one in people if one.role is MemberRole.CAPTAIN] == ["Captain"]
        assert tokens.authenticate(session, secret).team_id == left.id
        assert stored_stage(session, TRACK, "stage2").is_qualified(left)
        used = {use.quota: use.used for use in uses(session, Quotas(), left.id)}
        assert used[Quota.ATTEMPTS_PER_DAY] == 4
        found = newest_entries(session, 1, action="team.merge")[0]
        assert found.before == {"teams": ["Ants", "Bees"], "merged": str(ants.team_id)}
        assert found.after == {"teams": ["Bees"], "submissions": 2}


def test_a_merge_needs_an_organizer_and_two_teams_that_take_part(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = (teams.own(session, make_principal(session, name)) for name in ("Ants", "Bees"))
        by = make_principal(session, "Cats")
        with refused(ProblemCode.FORBIDDEN):
            merging.merge(session, by, ants, bees)
        with refused(ProblemCode.INVALID_REQUEST):
            merging.merge(session, CONSOLE, ants, ants)
        teams.disqualify(session, CONSOLE, bees, "two accounts")
        session.flush()
        for one, other in ((ants, bees), (bees, ants)):
            with refused(ProblemCode.TEAM_DISQUALIFIED):
                merging.merge(session, CONSOLE, one, other)
        assert {team.name for team in session.scalars(select(Team).order_by(Team.name_key))} == {"Ants", "Bees", "Cats"}


def test_a_merge_keeps_conflicts_of_interest_and_unsent_notices_and_says_no_address(database: Database) -> None:
    with database.transaction() as session:
        ants = teams.register(session, CONSOLE, name="Ants", contact="ann@example.org")
        bees = teams.own(session, make_principal(session, "Bees"))
        members.set_email(session, CONSOLE, members.find_captain(session, ants), "ann@example.org")
        outbox.announce(session, NoticeKind.FINISHED, ants.id, "evaluation:1", {})
        for team, judge, reason in ((ants, "Ann", "my students"), (ants, "Bob", "of Ants"), (bees, "Bob", "of Bees")):
            session.add(JudgingConflict(team_id=team.id, judge=judge, reason=reason))
        session.flush()
        merging.merge(session, CONSOLE, ants, bees)
        session.expire_all()
        found = {row.judge: (row.team_id, row.reason) for row in session.query(JudgingConflict)}
        assert found == {"Ann": (bees.id, "my students"), "Bob": (bees.id, "of Bees")}
        assert [notice.team_id for notice in session.query(Notice)] == [bees.id]
        assert "ann@example.org" not in str([(line.before, line.after) for line in newest_entries(session)])


@pytest.mark.parametrize("name", ["\u00df" * 64, "Captain" * 9, "a" + " b" * 31, "\ufb03" * 3])
def test_members_of_one_name_get_numbers_however_long_their_names_are_folded(database: Database, name: str) -> None:
    with database.transaction() as session:
        both = [teams.own(session, make_principal(session, team)) for team in ("Ants", "Bees", "Cats")]
        for team in both:
            captain = members.find_captain(session, team)
            captain.name, captain.name_key = name, teams.name_key(name)
        session.flush()
        for team in both[1:]:
            merging.merge(session, CONSOLE, team, both[0])
        named = [one.name for one in members.list_team_members(session, both[0].id)]
        assert sorted(one.rpartition(" ")[2] for one in named if one != name) == ["2", "3"]
        assert len({teams.name_key(one) for one in named}) == 3
        assert max(map(len, named)) <= teams.NAME_LENGTH


def test_nothing_is_merged_with_or_added_to_a_removed_team(database: Database) -> None:
    with database.transaction() as session:
        gone, bees = (make_principal(session, name) for name in ("Ants", "Bees"))
        submit(session, bees)
        removed, living = teams.own(session, gone), teams.own(session, bees)
        team_data.erase(session, CONSOLE, removed)
        for one, other in ((removed, living), (living, removed)):
            with refused(ProblemCode.UNKNOWN_TEAM):
                merging.merge(session, CONSOLE, one, other)
        with refused(ProblemCode.UNKNOWN_TEAM):
            submit(session, gone)
        for change in (teams.accept, teams.reinstate):
            with refused(ProblemCode.UNKNOWN_TEAM):
                change(session, CONSOLE, removed)
        with refused(ProblemCode.UNKNOWN_TEAM):
            teams.rename(session, CONSOLE, removed, "Ants again")


def test_who_submits_for_a_team_that_is_gone_gets_a_named_refusal(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        gone = teams.own(session, ants)
        merging.merge(session, CONSOLE, gone, teams.own(session, bees))
        with refused(ProblemCode.UNKNOWN_TEAM):
            teams.lock(session, gone)
        with refused(ProblemCode.NOT_FOUND):
            submit(session, ants)
