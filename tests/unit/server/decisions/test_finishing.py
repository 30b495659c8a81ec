from copy import deepcopy
from functools import partial
from typing import Any
from uuid import UUID

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, make_upload, outdate, submit_scored
from sqlalchemy import select, update
from submission_steps import SETTINGS, refused
from vitac.server.accounts import teams
from vitac.server.audit import newest_entries
from vitac.server.competitions.applying import freeze_boards, unfreeze_boards
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.view import competition_view
from vitac.server.database.engine import Database
from vitac.server.database.models import BoardResult, CompetitionRow, Rejudgement, Submission
from vitac.server.database.states import AppealState, Role
from vitac.server.decisions.finishing import Winner, concerns_at_end, finalize, reopen, winners, winning_entries
from vitac.server.decisions.judging import give_marks
from vitac.server.decisions.publishing import result_files
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.principals import CONSOLE, Principal
from vitac.server.receipts.issuing import receipts_of_ends
from vitac.server.submissions import appeals, creation, listing

from competitions import FIRST, SECOND, make_competition, moved, open_now, put_in_place, shown_stage, teams_on_board

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
        return [entry.team for entry in leaderboard(session, shown_stage(session, TRACK), live=live).view.entries]


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
        freeze_boards(session, CONSOLE)
        freeze_boards(session, CONSOLE)
    with played.transaction() as session:
        late = make_principal(session, "Eels")
        submission = submit_scored(session, late, "late", {TASK: make_score(200, 200)})
    assert names_on_board(played) == list(SUCCESSES)
    assert names_on_board(played, live=True) == ["Eels", *SUCCESSES]
    with played.transaction() as session:
        view = leaderboard(session, shown_stage(session, TRACK)).view
        assert view.frozen_at is not None
        assert leaderboard(session, shown_stage(session, TRACK), live=True).view.frozen_at is None
        assert log_boards(session, shown_stage(session, TRACK)).view.boards[0].entries == []
        shown = {by: listing.get(session, SETTINGS, by, submission.id).rank for by in (late, CONSOLE)}
        assert shown[late] is None
        assert shown[CONSOLE] is not None
        unfreeze_boards(session, CONSOLE)
    assert names_on_board(played) == ["Eels", *SUCCESSES]
    with played.transaction() as session:
        actions = [entry.action for entry in newest_entries(session) if entry.action.startswith("competition")]
    assert actions == ["competition.unfreeze", "competition.freeze"]


def test_the_final_winners_stay_whatever_happens_to_the_boards(played: Database) -> None:
    close(played)
    with played.transaction() as session:
        freeze_boards(session, CONSOLE)
    with played.transaction() as session:
        final = finalize(session, CONSOLE)
    with played.transaction() as session:
        outdate(session)
        assert winners(session) == final
        row = session.get_one(CompetitionRow, "cup")
        assert (row.frozen_at, row.finalized_at is not None) == (None, True)
        entry = newest_entries(session)[0]
        assert entry.action == "competition.finalize"
        (signed,) = receipts_of_ends(session)
        signed.require_valid()
        assert signed.end.winners == winning_entries(Competition.read(session))
        assert [winner.submission for winner in signed.end.winners] == [UUID(winner.submission) for winner in final]
        assert [winner["team"] for winner in entry.after["winners"]] == list(SUCCESSES)
    for change in (finalize, freeze_boards, unfreeze_boards):
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
    content["tracks"][TRACK]["stages"][1] |= {"qualified": None, "sealed": "at_once"}
    content["tracks"]["track_9"] = deepcopy(content["tracks"][TRACK]) | {"taken_here": False}
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        ants, bees = (make_principal(session, name) for name in ("Ants", "Bees"))
        submit_scored(session, ants, "first stage", {TASK: make_score(100)})
        put_in_place(session, open_now(content, stage=1))
        submit_scored(session, bees, "second stage", {TASK: make_score(50)})
        assert table(winners(session)) == [("Bees", "first", 2000)]
        assert teams_on_board(session, FIRST) == ["Ants"]
        assert leaderboard(session, shown_stage(session, TRACK)).view.stage == SECOND


def test_a_judged_track_is_won_by_total_once_every_ranked_team_has_one(played: Database) -> None:
    content = moved(one_stage(), days=-3650)
    content["tracks"][TRACK]["judging"] = {
        "criteria": [{"name": "structure", "title": "The structure"}],
        "judges_at_least": 1,
        "weights": {"success": 0.5, "judges": 0.5, "figures": 0},
    }
    with played.transaction() as session:
        put_in_place(session, content)
        of_team = {entry.team: entry for entry in leaderboard(session, shown_stage(session, TRACK)).view.entries}
    # Success is 0.45, 0.4, 0.375 and 0.05; these marks make 0.325, 0.7, 0.5875 and 0.325.
    marks = {"Dogs": 6.0, "Cats": 8.0, "Bees": 10.0, "Ants": 2.0}
    for n_judged, (team, mark) in enumerate(marks.items()):
        for end in (winners, partial(finalize, by=CONSOLE)):
            with refused(ProblemCode.STAGE_NOT_OVER) as said, played.transaction() as session:
                end(session)
            assert str(said.value).count("(0 of 1 judges)") == len(marks) - n_judged
        with played.transaction() as session:
            give_marks(session, CONSOLE, of_team[team].submission_id, {"structure": mark}, judge="X")
    with played.transaction() as session:
        final = finalize(session, CONSOLE)
        assert winners(session) == final
        assert list(of_team) == list(SUCCESSES), "the board stays one of success"
        files = result_files(session)
    assert table(final) == [
        ("Bees", "first", 2000),
        ("Cats", "second", 1000),
        ("Ants", "second", 1000),
        ("Dogs", "third", 500),
    ]
    assert [winner.total for winner in final] == [0.7, 0.5875, 0.325, 0.325], "Ants were ahead on the board"
    assert [winner.rank for winner in final] == [1, 2, 3, 4]
    assert "by a total of 70.0 %" in " ".join(files["results.html"].split())
    assert "total 58.8 %" in " ".join(files["certificates.html"].split())
    with refused(ProblemCode.COMPETITION_FINAL), played.transaction() as session:
        give_marks(session, CONSOLE, of_team["Dogs"].submission_id, {"structure": 10.0}, judge="X")


def test_without_a_competition_there_is_nothing_to_end(database: Database) -> None:
    for change in (finalize, freeze_boards, unfreeze_boards):
        with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
            change(session, CONSOLE)
    with refused(ProblemCode.NOT_FOUND), database.transaction() as session:
        winners(session)


@pytest.mark.parametrize("role", [Role.TEAM, Role.JUDGE])
def test_only_organizers_end_a_competition(played: Database, role: Role) -> None:
    for change in (finalize, freeze_boards, unfreeze_boards):
        with refused(ProblemCode.FORBIDDEN), played.transaction() as session:
            change(session, Principal(role=role))


def close_with_appeals(database: Database) -> None:
    """The stage is over, the time for appeals is not, and Bees have appealed."""
    with database.transaction() as session:
        put_in_place(session, moved(one_stage(appeal_days=7), days=-3650))
        bees = teams.find(session, "Bees")
        by = Principal(role=Role.TEAM, team_id=bees.id, team_name="Bees")
        submission = session.scalars(select(Submission).where(Submission.team_id == bees.id)).one()
        appeals.open_appeal(session, by, submission.id, "It was in the hole.")


def test_the_end_names_what_is_not_settled_and_waits_until_it_is_confirmed(played: Database) -> None:
    close_with_appeals(played)
    names = ["open_appeals", "appeal_time", "rejudgements", "boards_without_ranks"]
    with played.transaction() as session:
        session.add(Rejudgement(competition="cup", track=TRACK, stage=FIRST, reason="in doubt"))
        session.flush()
        found = concerns_at_end(session)
        assert [concern.name for concern in found] == names[:3]
        assert "appeals 1 of Bees" in found[0].sentence
        assert f"stage {FIRST} of {TRACK}" in found[2].sentence
        for missing in names[:3]:
            with pytest.raises(ServiceError, match=missing) as caught:
                finalize(session, CONSOLE, confirmed=set(names) - {missing})
            assert caught.value.code is ProblemCode.CONFIRMATION_NEEDED
        outdate(session)
    with played.transaction() as session:
        assert concerns_at_end(session)[-1].name == "boards_without_ranks"


def test_appeals_end_with_the_competition(played: Database) -> None:
    close_with_appeals(played)
    with played.transaction() as session:
        finalize(session, CONSOLE, confirmed=["open_appeals", "appeal_time"])
        (appeal,) = appeals.visible(session, CONSOLE)
        assert (appeal.state, appeal.ruling) == (
            AppealState.REJECTED,
            "The competition became final before anybody ruled on this appeal.",
        )
        ants = teams.find(session, "Ants")
        by = Principal(role=Role.TEAM, team_id=ants.id, team_name="Ants")
        submission = session.scalars(select(Submission).where(Submission.team_id == ants.id)).one()
        with pytest.raises(ServiceError, match="which ended appeals"):
            appeals.open_appeal(session, by, submission.id, "Mine, too.")


def test_an_end_is_taken_back_with_a_reason_that_everybody_reads(played: Database) -> None:
    close(played)
    with played.transaction() as session:
        with refused(ProblemCode.INVALID_REQUEST):
            reopen(session, CONSOLE, "too early")
        before = table(finalize(session, CONSOLE))
        with refused(ProblemCode.FORBIDDEN):
            reopen(session, Principal(role=Role.JUDGE), "an appeal")
        reopen(session, CONSOLE, "an appeal of Dogs was upheld")
        view = competition_view(session)
        assert (view.finalized_at, view.winners) == (None, [])
        assert [end.reason for end in view.reopened] == ["an appeal of Dogs was upheld"]
        entry = newest_entries(session)[0]
        assert entry.before is not None
        assert [winner["team"] for winner in entry.before["winners"]] == [team for team, _, _ in before]
        assert len(entry.before["boards"][0]["entries"]) == len(SUCCESSES)
        dogs = teams.find(session, "Dogs")
        submission = session.scalars(select(Submission).where(Submission.team_id == dogs.id)).one()
        session.execute(update(BoardResult).where(BoardResult.submission_id == submission.id).values(sort_key=[-1.0]))
    with played.transaction() as session:
        assert finalize(session, CONSOLE)[0].team == "Dogs"
        assert len(competition_view(session).reopened) == 1
        ends = [receipt.end for receipt in receipts_of_ends(session)]
        assert [(len(end.winners), end.reason) for end in ends] == [
            (len(before), None),
            (0, "an appeal of Dogs was upheld"),
            (len(before), None),
        ]
