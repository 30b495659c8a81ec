import pytest
from service_factories import TASK, TRACK, make_principal, make_score, outdate, submit_scored
from submission_steps import refused
from vitac.server.accounts import teams
from vitac.server.accounts.principals import CONSOLE
from vitac.server.db.engine import Database
from vitac.server.errors import ProblemCode
from vitac.server.leaderboards.standings import leaderboard
from vitac.server.people.team_data import erase
from vitac.server.results.archive import archive_view
from vitac.server.results.finishing import finalize, winners

from competitions import make_competition, moved, open_now, put_in_place

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


def test_the_archive_keeps_the_boards_of_the_end(final: Database) -> None:
    with final.transaction() as session:
        outdate(session)
        assert {entry.rank for entry in leaderboard(session, TRACK).view.entries} == {None}
        found = archive_view(session)
    (board,) = found.boards
    assert [(entry.team, entry.rank) for entry in board.entries] == [("Ants", 1), ("Bees", 2)]
    assert found.competition.finalized_at is not None
    assert len(found.public_key) == 64


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


def test_the_citation_is_one_entry_whatever_the_title_says(final: Database) -> None:
    with final.transaction() as session:
        found = archive_view(session)
    assert found.citation.startswith("@misc{cup,\n  title = {{The cup  inputx}},")
    assert "url   = {https://cup.example}" in found.citation
    assert found.citation.count("{") == found.citation.count("}")
