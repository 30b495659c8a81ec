from datetime import UTC, datetime
from typing import Any

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, make_upload, outdate, submit_scored
from sqlalchemy import update
from submission_steps import refused
from vitac.server.accounts import members, teams
from vitac.server.audit import newest_entries
from vitac.server.database.engine import Database
from vitac.server.database.models import Notice, Submission, Team
from vitac.server.database.states import NoticeKind, Role
from vitac.server.decisions.advancement import confirm, propose
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import CONSOLE, Principal
from vitac.server.receipts.issuing import list_entries
from vitac.server.submissions import creation
from vitac.server.transparency.entries import EntryKind
from vitac.server.views.competition import AdvancementView

from competitions import FIRST, SECOND, make_competition, open_now, put_in_place, stored_stage

SUCCESSES = {"Ants": 180, "Bees": 160, "Cats": 156, "Dogs": 20}
"""Of 200 in the one task of two that is played; Bees and Cats cannot be told apart."""


def begin(database: Database, rule: dict[str, Any], stage: int = 1) -> None:
    """Four teams have been scored in the first stage, and the second is open."""
    content = make_competition()
    content["tracks"][TRACK]["stages"][1]["qualified"] = rule
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        for name, successes in SUCCESSES.items():
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes, 200)})
        put_in_place(session, open_now(content, stage=stage))
    register_in_time(database)


def register_in_time(database: Database) -> None:
    """Makes all teams registered long before the first stage closed."""
    with database.transaction() as session:
        session.execute(update(Team).values(created_at=datetime(2020, 1, 1, tzinfo=UTC)))


def proposed(database: Database) -> AdvancementView:
    with database.transaction() as session:
        return propose(session, CONSOLE, stored_stage(session, TRACK, SECOND))


def confirmed(database: Database, **options: Any) -> list[str]:
    with database.transaction() as session:
        return confirm(session, CONSOLE, stored_stage(session, TRACK, SECOND), **options)


def test_the_rule_says_who_is_proposed_and_whose_intervals_meet_across_its_border(database: Database) -> None:
    begin(database, {"top": 2})
    for rule, advancing, at_border in (
        ({"top": 2}, ["Ants", "Bees"], ["Bees", "Cats"]),
        ({"top": 4}, ["Ants", "Bees", "Cats", "Dogs"], []),
        ({"top": 9}, ["Ants", "Bees", "Cats", "Dogs"], []),
        ({"top_share": 0.5}, ["Ants", "Bees"], ["Bees", "Cats"]),
        ({"top_share": 0.51}, ["Ants", "Bees", "Cats"], []),
        ({"top_share": 0.01}, ["Ants"], []),
        ({"score_at_least": 0.39}, ["Ants", "Bees", "Cats"], ["Bees", "Cats"]),
        ({"score_at_least": 0.4}, ["Ants", "Bees"], ["Bees", "Cats"]),
        ({"score_at_least": 0.99}, [], []),
    ):
        content = make_competition()
        content["tracks"][TRACK]["stages"][1]["qualified"] = rule
        with database.transaction() as session:
            put_in_place(session, open_now(content, stage=1))
        found = proposed(database)
        assert [team.team for team in found.teams if team.advances] == advancing, rule
        assert [team.team for team in found.teams if team.at_border] == at_border, rule
        assert (found.before, found.registered, found.running, found.unranked) == (FIRST, 4, 0, [])


def test_a_share_counts_teams_registered_in_time_but_disqualified_ones(database: Database) -> None:
    begin(database, {"top_share": 0.5})
    with database.transaction() as session:
        for name in ("Eels", "Foxes"):
            make_principal(session, name)
    assert proposed(database).registered == 4, "Who registers after the stage has closed counts."
    register_in_time(database)
    assert [team.team for team in proposed(database).teams if team.advances] == ["Ants", "Bees", "Cats"]
    with database.transaction() as session:
        out = {"disqualified_at": datetime.now(UTC), "disqualified_for": "two accounts"}
        session.execute(update(Team).where(Team.name.in_(["Ants", "Eels"])).values(**out))
    found = proposed(database)
    assert (found.registered, [team.team for team in found.teams if team.advances]) == (4, ["Bees", "Cats"])


def test_a_confirmed_team_may_submit_and_the_decision_is_recorded(database: Database) -> None:
    begin(database, {"top": 1})
    assert confirmed(database) == ["Ants"]
    with database.transaction() as session:
        assert propose(session, CONSOLE, stored_stage(session, TRACK, SECOND)).confirmed == ["Ants"]
        by = {name: session.query(Team).filter_by(name=name).one().id for name in SUCCESSES}
        for name, allowed in (("Ants", True), ("Bees", False)):
            principal = Principal(role=Role.TEAM, team_id=by[name], team_name=name)
            if allowed:
                assert creation.create(session, principal, make_upload(name))[0].stage == SECOND
            else:
                with refused(ProblemCode.NOT_QUALIFIED):
                    creation.create(session, principal, make_upload(name))
        entry = next(entry for entry in newest_entries(session) if entry.action == "stage.qualify")
        (logged,) = (one.statement for one in list_entries(session) if one.content is EntryKind.ADVANCEMENT)
        winner = session.query(Submission).filter_by(team_id=by["Ants"], stage=FIRST).one()
    assert logged is not None
    assert (logged["teams"], logged["submissions"]) == (1, [str(winner.id)]), "no name of a team"
    assert entry.subject == f"stage:cup/{TRACK}/{SECOND}"
    assert entry.before == {"teams": []}
    assert entry.after["teams"] == entry.after["proposed"] == ["Ants"]


def test_teams_advance_to_a_stage_of_another_track(database: Database) -> None:
    begin(database, {"top": 1})
    content = open_now(make_competition(), stage=1)
    final = content["tracks"][TRACK]["stages"].pop() | {"qualified": {"top": 1, "after": f"{TRACK}/{FIRST}"}}
    content["tracks"]["track_2"] = {"title": "Platform", "stages": [final]}
    with database.transaction() as session:
        put_in_place(session, content)
        stage = stored_stage(session, "track_2", SECOND)
        assert confirm(session, CONSOLE, stage) == ["Ants"]
        found = {team.name for team in session.query(Team) if stage.may_submit(team)}
    assert found == {"Ants"}


def test_a_person_in_two_teams_hears_of_both_and_of_a_second_confirmation(database: Database) -> None:
    begin(database, {"top": 2})
    with database.transaction() as session:
        for name in ("Ants", "Bees"):
            captain = members.find_captain(session, teams.find(session, name))
            members.set_email(session, CONSOLE, captain, "ann@example.org")
    for options in ({}, {"without": ["Bees"]}, {}):
        confirmed(database, **options)
    with database.transaction() as session:
        told = [notice.facts for notice in session.query(Notice).filter_by(kind=NoticeKind.PROMOTED)]
    assert sorted(facts["team"] for facts in told) == ["Ants", "Bees", "Bees"]
    assert {(facts["stage"], facts["stage_title"], facts["track_title"]) for facts in told} == {
        (SECOND, "Final", "Touch")
    }


def test_organizers_add_and_leave_out_teams(database: Database) -> None:
    begin(database, {"top": 2})
    assert confirmed(database, add=["dogs"], without=["Bees"]) == ["Ants", "Dogs"]
    assert confirmed(database) == ["Ants", "Bees"]
    with refused(ProblemCode.INVALID_REQUEST):
        confirmed(database, without=["Dogs"])
    with refused(ProblemCode.UNKNOWN_TEAM):
        confirmed(database, add=["Eels"])


def test_a_team_that_has_submitted_keeps_its_place(database: Database) -> None:
    begin(database, {"top": 1})
    confirmed(database)
    with database.transaction() as session:
        creation.create(session, CONSOLE, make_upload("late"), team="Ants")
    with pytest.raises(ServiceError, match="Ants has submitted") as caught:
        confirmed(database, without=["Ants"])
    assert caught.value.code is ProblemCode.STAGE_IN_USE


def test_nothing_is_confirmed_before_the_stage_is_over_and_scored(database: Database) -> None:
    begin(database, {"top": 1}, stage=0)
    with refused(ProblemCode.STAGE_NOT_OVER):
        confirmed(database)
    with database.transaction() as session:
        creation.create(session, CONSOLE, make_upload("late"), team="Dogs")
        content = open_now(make_competition(), stage=1)
        put_in_place(session, content)
    assert proposed(database).running == 1
    with refused(ProblemCode.STAGE_NOT_OVER):
        confirmed(database)


def test_results_of_another_evaluator_version_are_named_and_not_proposed(database: Database) -> None:
    begin(database, {"top": 1})
    with database.transaction() as session:
        outdate(session)
    found = proposed(database)
    assert found.teams == []
    assert found.unranked == ["Ants", "Bees", "Cats", "Dogs"]


def test_nobody_advances_to_a_stage_for_all_or_an_unknown_one_and_only_organizers_confirm(database: Database) -> None:
    begin(database, {"top": 1})
    for stage in (FIRST, "none"):
        with refused(ProblemCode.UNKNOWN_STAGE), database.transaction() as session:
            propose(session, CONSOLE, stored_stage(session, TRACK, stage))
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        confirm(session, Principal(role=Role.JUDGE), stored_stage(session, TRACK, SECOND))
    with database.transaction() as session:
        assert session.query(Submission).filter_by(stage=SECOND).count() == 0
