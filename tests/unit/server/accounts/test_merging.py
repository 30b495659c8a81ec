from datetime import timedelta

from service_factories import (
    TASK,
    TRACK,
    make_principal,
    make_score,
    make_secret,
    submit,
    submit_scored,
)
from submission_steps import refused
from vitac.server.accounts import members, merging, teams, tokens
from vitac.server.accounts.audit import newest_entries
from vitac.server.accounts.members import NewMember
from vitac.server.accounts.principals import CONSOLE
from vitac.server.accounts.quotas import uses
from vitac.server.competition.schedule import is_qualified
from vitac.server.db.engine import Database
from vitac.server.db.models import Qualification, Submission, Team
from vitac.server.db.states import MemberRole, Quota
from vitac.server.errors import ProblemCode
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.settings import Quotas


def test_a_merge_keeps_submissions_members_tokens_and_places_and_counts_quotas_together(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        secret = make_secret(session, ants)
        best = submit_scored(session, ants, "best", {TASK: make_score(90)}).id
        submit_scored(session, bees, "worse", {TASK: make_score(10)})
        both = [submit(session, team, "the same").id for team in (ants, bees)]
        session.add(Qualification(track=TRACK, stage="stage2", team_id=ants.team_id))
        old, new = teams.own(session, ants), teams.own(session, bees)
        _, code = members.invite(session, ants, old)
        members.join(session, NewMember(code=code, name="Ann"), timedelta(days=1))
        assert [entry.team for entry in leaderboard(session, TRACK, task=TASK).view.entries] == ["Ants", "Bees"]
        merging.merge(session, CONSOLE, old, new)
    with database.transaction() as session:
        assert session.get(Team, ants.team_id) is None
        left = teams.find(session, "Bees")
        assert {row.team_id for row in session.query(Submission)} == {left.id}
        assert [session.get_one(Submission, one).merged_from for one in both] == [ants.team_id, None]
        assert submit(session, bees, "the same").id == both[1]
        (entry,) = leaderboard(session, TRACK, task=TASK).view.entries
        assert (entry.team, entry.submission_id) == ("Bees", best)
        people = members.of_team(session, left.id)
        assert sorted(one.name for one in people) == ["Ann", "Captain", "Captain 2"]
        assert [one.name for one in people if one.role is MemberRole.CAPTAIN] == ["Captain"]
        assert tokens.authenticate(session, secret).team_id == left.id
        assert is_qualified(session, left, TRACK, "stage2")
        used = {use.quota: use.used for use in uses(session, Quotas(), left.id)}
        assert used[Quota.ATTEMPTS_PER_DAY] == 4
        found = newest_entries(session, 1, action="team.merge")[0]
        assert found.before == {"teams": ["Ants", "Bees"], "merged": str(ants.team_id), "contact": None}
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
        assert {team.name for team in teams.list_teams(session)} == {"Ants", "Bees", "Cats"}


def test_who_submits_for_a_team_that_is_gone_gets_a_named_refusal(database: Database) -> None:
    with database.transaction() as session:
        ants, bees = make_principal(session, "Ants"), make_principal(session, "Bees")
        gone = teams.own(session, ants)
        merging.merge(session, CONSOLE, gone, teams.own(session, bees))
        with refused(ProblemCode.UNKNOWN_TEAM):
            teams.lock(session, gone)
        with refused(ProblemCode.NOT_FOUND):
            submit(session, ants)
