from copy import deepcopy
from datetime import UTC, datetime
from typing import Any

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from submission_steps import refused
from vitac.server.audit import newest_entries
from vitac.server.contest.applying import Change, apply, changes_by
from vitac.server.contest.contest import Contest
from vitac.server.contest.definition import CompetitionDefinition
from vitac.server.contest.sealing import sealed_lists
from vitac.server.db.engine import Database
from vitac.server.db.models import Competition
from vitac.server.db.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal

from competitions import CLOSES, FIRST, OPENS, SECOND, make_competition


def applied(database: Database, content: dict[str, Any]) -> list[Change]:
    with database.transaction() as session:
        return apply(session, CONSOLE, CompetitionDefinition.model_validate(content))


def stages(content: dict[str, Any]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = content["tracks"][TRACK]["stages"]
    return found


def test_the_first_application_makes_the_competition_and_its_sealed_lists(database: Database) -> None:
    found = applied(database, make_competition())
    assert Change(place="title", before=None, after="The cup") in found
    assert Change(place=f"tracks.{TRACK}.stages.{SECOND}.qualified.top", before=None, after=1) in found
    with database.transaction() as session:
        assert Contest.read(session).definition.name == "cup"
        assert [(each.track, each.stage) for each in sealed_lists(session)] == [(TRACK, SECOND)]
        assert [entry.action for entry in newest_entries(session)] == ["list.seal", "competition.apply"]


def test_applying_twice_changes_nothing(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        before = (session.get_one(Competition, 1).applied_at, len(newest_entries(session)), sealed_lists(session)[0])
    assert applied(database, make_competition()) == []
    with database.transaction() as session:
        after = (session.get_one(Competition, 1).applied_at, len(newest_entries(session)), sealed_lists(session)[0])
        assert before[:2] == after[:2]
        assert before[2].commitment == after[2].commitment


def test_a_change_is_shown_and_recorded_with_before_and_after(database: Database) -> None:
    applied(database, make_competition())
    content = deepcopy(make_competition())
    stages(content)[0]["title"] = "Practice"
    stages(content)[1]["quotas"] = {}
    place = f"tracks.{TRACK}.stages"
    assert applied(database, content) == [
        Change(place=f"{place}.{FIRST}.title", before="Simulation", after="Practice"),
        Change(place=f"{place}.{SECOND}.quotas.scored_runs", before=2, after=None),
    ]
    with database.transaction() as session:
        entry = newest_entries(session)[0]
        assert entry.before is not None
        told = [values["tracks"][TRACK]["stages"][0]["title"] for values in (entry.before, entry.after)]
        assert told == ["Simulation", "Practice"]


def test_what_would_change_is_told_without_changing_it(database: Database) -> None:
    with database.transaction() as session:
        found = changes_by(session, CompetitionDefinition.model_validate(make_competition()))
        assert len(found) > 10
        assert not Contest.read(session).is_held
        assert sealed_lists(session) == []


def test_a_stage_with_submissions_is_neither_taken_away_nor_given_another_list(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        submit_scored(session, make_principal(session), "one", {TASK: make_score(50)}, at=OPENS)
    renamed, sealed, later = (deepcopy(make_competition()) for _ in range(3))
    stages(renamed)[0]["name"] = "stage0"
    stages(sealed)[0].update(list="sealed", accepts=["model"])
    for content, said in ((renamed, "taken away"), (sealed, "sealed list")):
        with pytest.raises(ServiceError, match=said) as caught:
            applied(database, content)
        assert caught.value.code is ProblemCode.STAGE_IN_USE
    stages(later)[0]["closes"] = CLOSES.replace(hour=12).isoformat()
    assert [change.place for change in applied(database, later)] == [f"tracks.{TRACK}.stages.{FIRST}.closes"]


def test_a_stage_that_turns_public_plays_no_sealed_list(database: Database) -> None:
    applied(database, make_competition())
    public = deepcopy(make_competition())
    stages(public)[1]["list"] = "public"
    assert [change.place for change in applied(database, public)] == [f"tracks.{TRACK}.stages.{SECOND}.list"]
    with database.transaction() as session:
        assert sealed_lists(session) == []
        withdrawn = newest_entries(session)[0]
        assert (withdrawn.action, withdrawn.after) == ("list.withdraw", {"commitment": None})
    assert applied(database, public) == []


def test_a_list_that_an_evaluation_plays_is_not_withdrawn(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        submission = submit_scored(session, make_principal(session), "one", {TASK: make_score(50)}, at=OPENS)
        newest_evaluation(session, submission).commitment = sealed_lists(session)[0].commitment
    public = deepcopy(make_competition())
    stages(public)[1]["list"] = "public"
    with refused(ProblemCode.STAGE_IN_USE):
        applied(database, public)
    assert applied(database, make_competition()) == []


def test_another_order_is_a_change(database: Database) -> None:
    prizes = [{"place": place, "amount": amount} for place, amount in (("first", 2000), ("second", 1000))]
    applied(database, make_competition(prizes=prizes))
    assert applied(database, make_competition(prizes=prizes[::-1])) == [
        Change(place=f"tracks.{TRACK}.prizes", before=["first", "second"], after=["second", "first"])
    ]
    with database.transaction() as session:
        found = Contest.read(session).definition
        assert [prize.place for prize in found.tracks[TRACK].prizes] == ["second", "first"]


def test_a_final_competition_does_not_change(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        row = session.get_one(Competition, 1)
        row.finalized_at, row.winners = datetime.now(UTC), []
    assert applied(database, make_competition()) == []
    with refused(ProblemCode.COMPETITION_FINAL):
        applied(database, make_competition(title="Another"))


@pytest.mark.parametrize("role", [Role.TEAM, Role.JUDGE])
def test_only_organizers_apply(database: Database, role: Role) -> None:
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        apply(session, Principal(role=role), CompetitionDefinition.model_validate(make_competition()))
