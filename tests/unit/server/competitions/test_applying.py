from collections.abc import Collection
from copy import deepcopy
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from submission_steps import refused
from vitac.server.audit import newest_entries
from vitac.server.competitions.applying import Change, apply, list_changes, list_concerns, unfreeze_boards
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.competitions.sealing import reveal, sealed_lists
from vitac.server.competitions.view import competition_view
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow
from vitac.server.database.states import Role
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.principals import CONSOLE, Principal

from competitions import (
    CLOSES,
    FIRST,
    LATER_CLOSES,
    OPENS,
    PUBLIC_RANKING,
    SECOND,
    make_competition,
    moved,
    sealed_competition,
)


def applied(
    database: Database, content: dict[str, Any], *, base: str | None = None, confirmed: Collection[str] | None = ()
) -> list[Change]:
    with database.transaction() as session:
        definition = CompetitionDefinition.model_validate(content)
        confirmed = None if confirmed is None else {*confirmed, PUBLIC_RANKING}
        return apply(session, CONSOLE, definition, base=base, confirmed=confirmed)


def require_confirmation(database: Database, content: dict[str, Any], place: str, sentence: str) -> None:
    """The file is refused until its one concern is confirmed by its name; then it is applied."""
    with pytest.raises(ServiceError, match=sentence) as caught:
        applied(database, content)
    assert (caught.value.code, caught.value.extras) == (ProblemCode.CONFIRMATION_NEEDED, {"concerns": [place]})
    with pytest.raises(ServiceError, match=sentence):
        applied(database, content, confirmed=["another"])
    assert applied(database, content, confirmed=[place])


def lists_of(database: Database) -> dict[str, tuple[str, bool]]:
    """Commitment of each stage, and whether it is withdrawn."""
    with database.transaction() as session:
        return {
            each.stage: (each.commitment, each.withdrawn_at is not None)
            for each in sealed_lists(session, Competition.read(session))
        }


def stages(content: dict[str, Any]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = content["tracks"][TRACK]["stages"]
    return found


def test_the_first_application_makes_the_competition_and_its_sealed_lists(database: Database) -> None:
    found = applied(database, make_competition())
    assert Change(place="title", before=None, after="The cup") in found
    assert Change(place=f"tracks.{TRACK}.stages.{SECOND}.qualified.top", before=None, after=1) in found
    with database.transaction() as session:
        assert Competition.read(session).definition.name == "cup"
        assert [(each.track, each.stage) for each in sealed_lists(session, Competition.read(session))] == [
            (TRACK, SECOND)
        ]
        assert [entry.action for entry in newest_entries(session)] == ["list.seal", "competition.apply"]


def test_applying_twice_changes_nothing(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        before = (
            session.get_one(CompetitionRow, "cup").applied_at,
            len(newest_entries(session)),
            sealed_lists(session, Competition.read(session))[0],
        )
    assert applied(database, make_competition()) == []
    with database.transaction() as session:
        after = (
            session.get_one(CompetitionRow, "cup").applied_at,
            len(newest_entries(session)),
            sealed_lists(session, Competition.read(session))[0],
        )
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
        found = list_changes(session, CompetitionDefinition.model_validate(make_competition()))
        assert len(found) > 10
        assert not Competition.read(session).is_held
        assert sealed_lists(session, Competition.read(session)) == []


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


def test_a_stage_that_turns_public_and_sealed_again_has_the_list_that_was_committed_to(database: Database) -> None:
    applied(database, make_competition())
    (commitment, _), public = lists_of(database)[SECOND], deepcopy(make_competition())
    stages(public)[1]["list"] = "public"
    place = f"tracks.{TRACK}.stages.{SECOND}.list"
    require_confirmation(database, public, place, f"The commitment {commitment} was published at")
    assert lists_of(database) == {SECOND: (commitment, True)}
    with database.transaction() as session:
        view = competition_view(session)
        assert view.tracks[0].stages[1].commitment is None
        assert [(each.stage, each.commitment) for each in view.withdrawn_lists] == [(SECOND, commitment)]
    applied(database, make_competition())
    assert lists_of(database) == {SECOND: (commitment, False)}
    with database.transaction() as session:
        assert competition_view(session).withdrawn_lists == []


def test_the_list_of_a_stage_with_another_name_is_shown_as_withdrawn(database: Database) -> None:
    applied(database, make_competition())
    (commitment, _), renamed = lists_of(database)[SECOND], deepcopy(make_competition())
    stages(renamed)[1]["name"] = "final"
    require_confirmation(database, renamed, f"tracks.{TRACK}.stages.{SECOND}.list", commitment)
    assert {stage: withdrawn for stage, (_, withdrawn) in lists_of(database).items()} == {SECOND: True, "final": False}


def test_a_list_that_an_evaluation_plays_is_not_withdrawn(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        submission = submit_scored(session, make_principal(session), "one", {TASK: make_score(50)}, at=OPENS)
        newest_evaluation(session, submission).commitment = sealed_lists(session, Competition.read(session))[
            0
        ].commitment
    public = deepcopy(make_competition())
    stages(public)[1]["list"] = "public"
    with refused(ProblemCode.STAGE_IN_USE):
        applied(database, public, confirmed=None)
    assert applied(database, make_competition()) == []


def test_another_order_is_a_change(database: Database) -> None:
    prizes = [{"place": place, "amount": amount} for place, amount in (("first", 2000), ("second", 1000))]
    applied(database, make_competition(prizes=prizes))
    assert applied(database, make_competition(prizes=prizes[::-1])) == [
        Change(place=f"tracks.{TRACK}.prizes", before=["first", "second"], after=["second", "first"])
    ]
    with database.transaction() as session:
        found = Competition.read(session).definition
        assert [prize.place for prize in found.tracks[TRACK].prizes] == ["second", "first"]


def test_a_final_competition_does_not_change(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        row = session.get_one(CompetitionRow, "cup")
        row.finalized_at, row.winners = datetime.now(UTC), []
    assert applied(database, make_competition()) == []
    with refused(ProblemCode.COMPETITION_FINAL):
        applied(database, make_competition(title="Another"))


@pytest.mark.parametrize("role", [Role.TEAM, Role.JUDGE])
def test_only_organizers_apply(database: Database, role: Role) -> None:
    with refused(ProblemCode.FORBIDDEN), database.transaction() as session:
        apply(session, Principal(role=role), CompetitionDefinition.model_validate(make_competition()))


def with_submission(database: Database, content: dict[str, Any], *, at: datetime) -> None:
    """Applies a file, and submits to its first stage."""
    applied(database, content)
    with database.transaction() as session:
        submission = submit_scored(session, make_principal(session), "one", {TASK: make_score(50)}, at=at)
        submission.submitted_at = at


@pytest.mark.parametrize(
    ("change", "place", "sentence"),
    [
        ({"appeal_days": 3}, "appeal_days", "1 submissions were made while teams could appeal for no time"),
        (
            {"ranking": ["mean_steps", "submitted_at"]},
            f"tracks.{TRACK}.ranking",
            "1 submissions, which were made under another ranking rule",
        ),
        ({"taken_here": False}, f"tracks.{TRACK}.taken_here", "its boards close"),
    ],
)
def test_a_rule_under_which_teams_have_submitted_changes_only_where_it_is_confirmed(
    database: Database, change: dict[str, Any], place: str, sentence: str
) -> None:
    public = make_competition()
    stages(public)[1]["list"] = "public"
    with_submission(database, public, at=OPENS)
    changed = make_competition(**change)
    stages(changed)[1]["list"] = "public"
    require_confirmation(database, changed, place, sentence)


def test_rules_under_which_nobody_has_submitted_change_without_a_question(database: Database) -> None:
    applied(database, make_competition())
    assert applied(database, make_competition(appeal_days=3, ranking=["mean_steps", "submitted_at"]))


@pytest.mark.parametrize(
    ("key", "days", "said"), [("closes", -20, "were made after"), ("opens", 20, "were made before")]
)
def test_times_are_not_moved_over_submissions_without_confirmation(
    database: Database, key: str, days: int, said: str
) -> None:
    with_submission(database, make_competition(), at=OPENS + timedelta(days=15))
    changed = deepcopy(make_competition())
    stages(changed)[0][key] = (datetime.fromisoformat(stages(changed)[0][key]) + timedelta(days=days)).isoformat()
    require_confirmation(database, changed, f"tracks.{TRACK}.stages.{FIRST}.{key}", f"1 submissions {said}")


def test_a_stage_that_is_over_opens_again_only_where_it_is_confirmed_and_never_after_its_reveal(
    database: Database,
) -> None:
    over = moved(sealed_competition(), days=(datetime.now(UTC) - LATER_CLOSES) / timedelta(days=1) - 10)
    applied(database, over)
    later = deepcopy(over)
    stages(later)[1]["closes"] = (datetime.now(UTC) + timedelta(days=2)).isoformat()
    require_confirmation(database, later, f"tracks.{TRACK}.stages.{SECOND}.closes", "The stage has been over since")
    applied(database, over, confirmed=None)
    with database.transaction() as session:
        reveal(session, CONSOLE, Competition.read(session).stage(TRACK, SECOND))
    with pytest.raises(ServiceError, match="never opens again") as caught:
        applied(database, later, confirmed=None)
    assert caught.value.code is ProblemCode.STAGE_IN_USE


def test_a_file_that_was_made_from_another_one_is_refused_with_the_difference(database: Database) -> None:
    applied(database, make_competition())
    with database.transaction() as session:
        base = Competition.read(session).revision
    applied(database, make_competition(title="The first cup"), base=base)
    second = make_competition(summary="By touch.")
    with pytest.raises(ServiceError, match="title: The cup -> The first cup") as caught:
        applied(database, second, base=base)
    assert caught.value.code is ProblemCode.CHANGED_MEANWHILE
    with pytest.raises(ServiceError, match=r"The file would change .*title: The first cup -> The cup"):
        applied(database, second, base="")
    with database.transaction() as session:
        assert Competition.read(session).definition.title == "The first cup"
    now = str(caught.value.extras["revision"])
    assert applied(database, make_competition(title="The first cup", summary="By touch."), base=now)


def test_boards_freeze_by_themselves_at_the_time_in_the_file(database: Database) -> None:
    soon, over = (datetime.now(UTC) + timedelta(days=days) for days in (1, -1))
    applied(database, make_competition(freeze_at=soon.isoformat()))
    with database.transaction() as session:
        assert Competition.read(session).frozen_at is None
        assert Competition.read(session).row.frozen_at == soon
    applied(database, make_competition(freeze_at=over.isoformat()))
    with database.transaction() as session:
        assert Competition.read(session).frozen_at == over
        unfreeze_boards(session, CONSOLE)
        assert Competition.read(session).stage(TRACK, FIRST).frozen_at is None
    applied(database, make_competition(freeze_at=over.isoformat(), title="Another"))
    with database.transaction() as session:
        assert Competition.read(session).frozen_at is None, "the organizers have shown all results since"


def test_what_a_public_list_decides_is_confirmed_once(database: Database) -> None:
    content = make_competition(prizes=[{"place": "first", "amount": 100}])
    definition = CompetitionDefinition.model_validate(content)
    with database.transaction() as session:
        concerns = {concern.name: concern.sentence for concern in list_concerns(session, definition)}
    assert concerns.keys() == {PUBLIC_RANKING}
    assert "Final of Touch is for teams by Simulation, which plays a public list" in concerns[PUBLIC_RANKING]
    applied(database, content)
    stages(content)[1]["list"] = "public"
    with database.transaction() as session:
        concerns = {
            concern.name: concern.sentence
            for concern in list_concerns(session, CompetitionDefinition.model_validate(content))
        }
        shown = competition_view(session).public_rankings
    assert "The prizes of Touch go by the board of Final" in concerns[f"tracks.{TRACK}.prizes"]
    assert PUBLIC_RANKING not in concerns
    assert shown == ["Final of Touch is for teams by Simulation"]
