from copy import deepcopy
from typing import Any

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, make_upload, outdate, submit_scored
from submission_steps import SETTINGS, refused
from vitac.server.accounts.audit import newest_entries
from vitac.server.accounts.principals import CONSOLE, Principal
from vitac.server.db.engine import Database
from vitac.server.db.models import Competition
from vitac.server.db.states import Role
from vitac.server.errors import ProblemCode
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.results.finishing import Winner, finalize, freeze, unfreeze, winners
from vitac.server.submissions import creation, listing

from competitions import FIRST, SECOND, make_competition, moved, open_now, put_in_place

PRIZES = [
    {"place": "first", "amount": 2000, "winners": 1, "note": "a talk"},
    {"place": "second", "amount": 1000, "winners": 2},
    {"place": "third", "amount": 500, "winners": 3},
]
SUCCESSES = {"Ants": 180, "Bees": 160, "Cats": 150, "Dogs": 20}


def one_stage(**changes: Any) -> dict[str, Any]:
    content = make_competition(prizes=PRIZES, **changes)
    del content["tracks"][TRACK]["stages"][1]
    return content


@pytest.fixture
def played(database: Database) -> Database:
    """A competition of one open stage with four scored teams."""
    with database.transaction() as session:
        put_in_place(session, open_now(one_stage()))
        for name, successes in SUCCESSES.items():
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes, 200)})
    return database


def close(database: Database) -> None:
    with database.transaction() as session:
        put_in_place(session, moved(one_stage(), days=-3650))


def names_on_board(database: Database, *, live: bool = False) -> list[str]:
    with database.transaction() as session:
        return [entry.team for entry in leaderboard(session, TRACK, live=live).view.entries]


def table(found: list[Winner]) -> list[tuple[str, str, int]]:
    return [(winner.team, winner.place, winner.amount) for winner in found]


def test_prizes_go_down_the_board_of_the_last_stage(played: Database) -> None:
    with played.transaction() as session:
        found = winners(session)
    assert table(found) == [
        ("Ants", "first", 2000),
        ("Bees", "second", 1000),
        ("Cats", "second", 1000),
        ("Dogs", "third", 500),
    ]
    assert (found[0].rank, found[0].success_rate, found[0].note, found[0].currency) == (1, 0.45, "a talk", "USD")


def test_a_frozen_board_stands_still_for_all_but_organizers(played: Database) -> None:
    with played.transaction() as session:
        freeze(session, CONSOLE)
        freeze(session, CONSOLE)
    with played.transaction() as session:
        late = make_principal(session, "Eels")
        submission = submit_scored(session, late, "late", {TASK: make_score(200, 200)})
    assert names_on_board(played) == list(SUCCESSES)
    assert names_on_board(played, live=True) == ["Eels", *SUCCESSES]
    with played.transaction() as session:
        view = leaderboard(session, TRACK).view
        assert view.frozen_at is not None
        assert leaderboard(session, TRACK, live=True).view.frozen_at is None
        assert log_boards(session, TRACK).view.boards[0].entries == []
        shown = {by: listing.get(session, SETTINGS, by, submission.id).rank for by in (late, CONSOLE)}
        assert shown[late] is None
        assert shown[CONSOLE] is not None
        unfreeze(session, CONSOLE)
    assert names_on_board(played) == ["Eels", *SUCCESSES]
    with played.transaction() as session:
        actions = [entry.action for entry in newest_entries(session) if entry.action.startswith("competition")]
    assert actions == ["competition.unfreeze", "competition.freeze"]


def test_the_final_winners_stay_whatever_happens_to_the_boards(played: Database) -> None:
    close(played)
    with played.transaction() as session:
        freeze(session, CONSOLE)
    with played.transaction() as session:
        final = finalize(session, CONSOLE)
    with played.transaction() as session:
        outdate(session)
        assert winners(session) == final
        row = session.get_one(Competition, 1)
        assert (row.frozen_at, row.finalized_at is not None) == (None, True)
        entry = newest_entries(session)[0]
        assert entry.action == "competition.finalize"
        assert [winner["team"] for winner in entry.after["winners"]] == list(SUCCESSES)
    for change in (finalize, freeze, unfreeze):
        with refused(ProblemCode.COMPETITION_FINAL), played.transaction() as session:
            change(session, CONSOLE)


def test_nothing_is_final_before_the_last_stage_is_over_and_scored(played: Database) -> None:
    with refused(ProblemCode.STAGE_NOT_OVER), played.transaction() as session:
        finalize(session, CONSOLE)
    with played.transaction() as session:
        creation.create(session, CONSOLE, make_upload("late"), team="Ants")
    close(played)
    with refused(ProblemCode.STAGE_NOT_OVER), played.transaction() as session:
        finalize(session, CONSOLE)


def test_results_of_another_evaluator_version_win_nothing_unnoticed(played: Database) -> None:
    close(played)
    with played.transaction() as session:
        outdate(session)
    with refused(ProblemCode.RESULTS_OUTDATED), played.transaction() as session:
        winners(session)
    with refused(ProblemCode.RESULTS_OUTDATED), played.transaction() as session:
        finalize(session, CONSOLE)


def test_the_last_stage_decides_and_tracks_elsewhere_have_no_winners_here(database: Database) -> None:
    content = make_competition(prizes=PRIZES)
    content["tracks"][TRACK]["stages"][1]["qualified"] = None
    content["tracks"]["track_9"] = deepcopy(content["tracks"][TRACK]) | {"taken_here": False}
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        ants, bees = (make_principal(session, name) for name in ("Ants", "Bees"))
        submit_scored(session, ants, "first stage", {TASK: make_score(100)})
        put_in_place(session, open_now(content, stage=1))
        submit_scored(session, bees, "second stage", {TASK: make_score(50)})
        assert table(winners(session)) == [("Bees", "first", 2000)]
        assert [entry.team for entry in leaderboard(session, TRACK, stage=FIRST).view.entries] == ["Ants"]
        assert leaderboard(session, TRACK).view.stage == SECOND


def test_without_a_competition_there_is_nothing_to_end(database: Database) -> None:
    for change in (finalize, freeze, unfreeze):
        with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
            change(session, CONSOLE)
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        winners(session)


@pytest.mark.parametrize("role", [Role.TEAM, Role.JUDGE])
def test_only_organizers_end_a_competition(played: Database, role: Role) -> None:
    for change in (finalize, freeze, unfreeze):
        with refused(ProblemCode.FORBIDDEN), played.transaction() as session:
            change(session, Principal(role=role))
