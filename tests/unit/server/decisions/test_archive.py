import csv
import io
from datetime import timedelta

import pytest
from service_factories import TASK, TRACK, make_principal, make_score, make_settings, outdate, submit_scored
from sqlalchemy import delete, null, select, update
from sqlalchemy.orm import Session
from submission_steps import refused
from vitac.evaluator import version
from vitac.evaluator.tracks import Track, UnknownTrack, registry
from vitac.evaluator.version import evaluator_version
from vitac.server.accounts import teams
from vitac.server.accounts.teams import disqualify, reinstate
from vitac.server.audit import newest_entries
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.view import competition_view, disqualified_since_the_end
from vitac.server.database.engine import Database
from vitac.server.database.models import CompetitionRow, Evaluation, Submission
from vitac.server.database.states import Role
from vitac.server.decisions.finishing import finalize, finalize_again, winners
from vitac.server.decisions.publishing import archive_view, result_files
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.operations.team_data import erase
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions.listing import list_submissions
from vitac.server.views.leaderboards import LeaderboardView

from competitions import make_competition, moved, open_now, put_in_place, shown_stage, teams_on_board

PRIZES = [{"place": "first", "amount": 2000, "winners": 1}, {"place": "second", "amount": 1000, "winners": 1}]


@pytest.fixture
def final(database: Database) -> Database:
    """A competition with a dangerous title that is final, with two teams."""
    content = make_competition(title="The {cup} & \\input{x}", website="https://cup.example", prizes=PRIZES)
    del content["tracks"][TRACK]["stages"][1]
    with database.transaction() as session:
        put_in_place(session, open_now(content))
        for name, successes in (("Ants", 80), ("Bees", 70)):
            submit_scored(session, make_principal(session, name), name, {TASK: make_score(successes)})
    with database.transaction() as session:
        with refused(ProblemCode.NOT_FOUND):
            archive_view(session)
        put_in_place(session, moved(content, days=-3650))
        finalize(session, CONSOLE)
    return database


def submit_late(session: Session) -> Submission:
    """A result of the Bees that would lead, from within the stage, but complete only after the end."""
    bees = teams.find(session, "Bees")
    by = Principal(role=Role.TEAM, team_id=bees.id, team_name=bees.name, leads_team=True)
    opened = shown_stage(session, TRACK).rules.opens
    return submit_scored(session, by, "after the end", {TASK: make_score(99)}, at=opened + timedelta(seconds=1))


def test_the_archive_keeps_the_boards_of_the_end(final: Database) -> None:
    with final.transaction() as session:
        outdate(session)
        found = archive_view(session)
    (board,) = found.boards
    assert [(entry.team, entry.rank) for entry in board.entries] == [("Ants", 1), ("Bees", 2)]
    assert found.competition.finalized_at is not None
    assert len(found.public_key) == 64


def test_the_boards_stay_as_they_are_after_an_upgrade_of_the_evaluator(
    final: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = evaluator_version()
    for module in (version, registry):
        monkeypatch.setattr(module, "evaluator_hash", lambda: "f" * 64)
    assert evaluator_version() != before
    with final.transaction() as session:
        late = submit_late(session)
        late_run = session.scalars(select(Evaluation).where(Evaluation.submission_id == late.id)).one()
        assert late_run.evaluator_version == evaluator_version()
    with final.transaction() as session:
        (kept,) = archive_view(session).boards
        for live in (False, True):
            board = leaderboard(session, shown_stage(session, TRACK), live=live).view
            assert board.entries == kept.entries
            assert (board.evaluator_version, board.final_since) == (before, kept.final_since)
            assert board.final_since == competition_view(session).finalized_at
        of_task = leaderboard(session, shown_stage(session, TRACK), task=TASK).view
        assert [(entry.team, entry.rank, entry.stale) for entry in of_task.entries] == [
            ("Ants", 1, False),
            ("Bees", 2, False),
        ]
        logs = log_boards(session, shown_stage(session, TRACK)).view
        assert (logs.final_since, logs.evaluator_version) == (kept.final_since, before)
        ranks = [row["rank"] for row in csv.DictReader(io.StringIO(result_files(session)["results.csv"]))]
        assert ranks == ["1", "2"]
        shown = {found.id: found for found in list_submissions(session, make_settings(), CONSOLE).items}
        places = [shown[entry.submission_id].rank for entry in kept.entries]
        assert [place.rank for place in places if place] == [1, 2]
        assert shown[late.id].rank is None, "it came after the end"


def test_a_later_result_of_the_same_version_changes_no_final_board(final: Database) -> None:
    with final.transaction() as session:
        submit_late(session)
    with final.transaction() as session:
        assert teams_on_board(session) == ["Ants", "Bees"]


def test_a_competition_that_was_final_before_boards_were_kept_ranks_by_the_present_version(final: Database) -> None:
    with final.transaction() as session:
        session.execute(update(CompetitionRow).values(boards=null()))
        session.expire_all()
        found = leaderboard(session, shown_stage(session, TRACK)).view
    assert [entry.rank for entry in found.entries] == [1, 2]
    assert found.evaluator_version == evaluator_version()


def test_a_removed_team_is_not_named_in_the_archive(final: Database) -> None:
    with final.transaction() as session:
        ants = teams.find(session, "Ants")
        erase(session, CONSOLE, ants)
        gone = ants.name
    with final.transaction() as session:
        (board,) = archive_view(session).boards
        prized = [winner.team for winner in winners(session)]
    assert [entry.team for entry in board.entries] == [gone, "Bees"]
    assert prized == [gone, "Bees"]


def test_a_team_disqualified_after_the_end_stays_until_the_results_are_finalized_again(
    final: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    with final.transaction() as session:
        before = archive_view(session)
        disqualify(session, CONSOLE, teams.find(session, "Ants"), "two accounts")
    for module in (version, registry):
        monkeypatch.setattr(module, "evaluator_hash", lambda: "f" * 64)
    with final.transaction() as session:
        submit_late(session)
        struck = archive_view(session)
        assert (struck.boards, struck.competition.winners) == (before.boards, before.competition.winners)
        assert [each.team for each in struck.competition.disqualified] == ["Ants"]
        assert "two accounts" not in struck.model_dump_json(), "the reason is told to the team"
        assert teams_on_board(session) == ["Bees"]
        with pytest.raises(ServiceError, match=r"got Ants, disqualified after the end; .*--again"):
            result_files(session)
    assert again(final) == [("Bees", "first", 1)]
    with final.transaction() as session:
        found = archive_view(session)
        (board,) = found.boards
        assert [(entry.team, entry.rank) for entry in board.entries] == [("Bees", 1)]
        assert board.evaluator_version == before.boards[0].evaluator_version != evaluator_version()
        assert (found.competition.disqualified, found.competition.finalized_at) == ([], before.competition.finalized_at)
        assert "Bees" in result_files(session)["certificates.html"]
        noted = newest_entries(session, action="competition.finalize_again")[0]
        assert noted.before is not None
        assert [winner["team"] for winner in noted.before["winners"]] == ["Ants", "Bees"]
        assert [LeaderboardView.model_validate(kept) for kept in noted.before["boards"]] == before.boards
        assert (before.decided_again_at, found.decided_again_at) == (None, noted.at)
        reinstate(session, CONSOLE, teams.find(session, "Ants"))
    assert again(final) == again(final) == [("Ants", "first", 1), ("Bees", "second", 2)]


def test_without_a_track_file_nothing_is_decided_again(final: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    with final.transaction() as session:
        before = archive_view(session)
        disqualify(session, CONSOLE, teams.find(session, "Ants"), "two accounts")

    def removed(name: str) -> Track:
        raise UnknownTrack(name)

    with final.transaction() as session:
        monkeypatch.setattr("vitac.server.tracks.load_track", removed)
        with pytest.raises(ServiceError, match=f"got none of {TRACK}; put it back") as said:
            finalize_again(session, CONSOLE)
        assert said.value.code is ProblemCode.UNKNOWN_TRACK
    monkeypatch.undo()
    with final.transaction() as session:
        found = archive_view(session)
        assert (found.boards, found.competition.winners) == (before.boards, before.competition.winners)
        assert found.decided_again_at is None
        assert newest_entries(session, action="competition.finalize_again") == []
    assert again(final) == [("Bees", "first", 1)], "once the file is back"


def again(final: Database) -> list[tuple[str, str, int]]:
    with final.transaction() as session:
        return [(winner.team, winner.place, winner.rank) for winner in finalize_again(session, CONSOLE)]


def test_only_an_organizer_finalizes_again_and_only_what_is_final(final: Database) -> None:
    with final.transaction() as session:
        with refused(ProblemCode.FORBIDDEN):
            finalize_again(session, Principal(role=Role.JUDGE, judge_name="Prof. X"))
        session.execute(update(CompetitionRow).values(finalized_at=null(), winners=null(), boards=null()))
        session.expire_all()
        with pytest.raises(ServiceError, match="is not final yet"):
            finalize_again(session, CONSOLE)
        assert disqualified_since_the_end(Competition.read(session)) == []
        session.execute(delete(CompetitionRow))
        session.expire_all()
        with refused(ProblemCode.NOT_FOUND):
            finalize_again(session, CONSOLE)


def test_the_citation_is_one_entry_whatever_the_title_says(final: Database) -> None:
    with final.transaction() as session:
        found = archive_view(session)
    assert found.citation.startswith("@misc{cup,\n  title = {{The cup  inputx}},")
    assert "url   = {https://cup.example}" in found.citation
    assert found.citation.count("{") == found.citation.count("}")
