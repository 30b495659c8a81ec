from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from uuid import UUID

import pytest
from database_work import database_work
from databases import copied_database, fresh_database
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from service_factories import LOCK, TASK, TRACK, add_result, make_score
from sqlalchemy import select, text
from vitac.evaluator.ranking import Ranking
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Team
from vitac.server.evaluations.scores import combined_score, read_scores
from vitac.server.leaderboards import standings
from vitac.server.leaderboards.best_entries import Board, best_entries, places
from vitac.server.leaderboards.log_boards import log_boards
from vitac.server.leaderboards.standings import leaderboard

from competitions import shown_stage

TEAMS = 4
BEGIN = datetime(2026, 1, 1, tzinfo=UTC)

scores = st.builds(
    # Few values, so that rates, steps and times are often equal.
    lambda successes, steps: make_score(successes, 4, steps if successes else None),
    st.integers(0, 4),
    st.sampled_from((3.0, 3.5, 1e-9)),
)
results = st.tuples(
    st.integers(0, TEAMS - 1),
    st.dictionaries(st.sampled_from((TASK, LOCK)), scores, min_size=1),
    st.integers(0, 2).map(lambda minute: BEGIN + timedelta(minutes=minute)),
    st.sampled_from((evaluator_version(), evaluator_version(), "0+old", "0+older")),
    st.sampled_from((SubmissionKind.MODEL, SubmissionKind.MODEL, SubmissionKind.LOG)),
    st.uuids(),
)


def best_by_the_rule(evaluations: Sequence[Evaluation], task: str | None) -> list[UUID]:
    """Ids of each team's best evaluation on a board, by the evaluator's own function."""
    ranking, candidates = Ranking(), []
    for evaluation in evaluations:
        score = combined_score(evaluation) if task is None else read_scores(evaluation).get(task)
        if score is not None:
            key = ranking.sort_key(ranking.values(score, evaluation.created_at))
            candidates.append((key, evaluation.id, evaluation.submission.team_id))
    best: dict[UUID, UUID] = {}
    for _, evaluation_id, team_id in sorted(candidates):
        best.setdefault(team_id, evaluation_id)
    return list(best.values())


@given(st.lists(results, max_size=14, unique_by=lambda result: result[-1]))
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_the_database_ranks_as_the_evaluator_does(database: Database, drawn: list[tuple[object, ...]]) -> None:
    with database.transaction() as session:
        teams = [Team(name=f"Team {number}", name_key=f"team {number}") for number in range(TEAMS)]
        session.add_all(teams)
        for number, (team, *rest) in enumerate(drawn):
            add_result(session, number, teams[team], *rest)  # type: ignore[call-overload, arg-type]
        models = [
            evaluation
            for evaluation in session.scalars(select(Evaluation))
            if evaluation.submission.kind is SubmissionKind.MODEL
        ]
        current = [evaluation for evaluation in models if evaluation.evaluator_version == evaluator_version()]
        for task in (None, TASK, LOCK):
            entries = best_entries(session, Board(track=TRACK, task=task))
            ranked = best_by_the_rule(current, task)
            teams_of_ranked = {session.get_one(Evaluation, found).submission.team_id for found in ranked}
            others = [model for model in models if model.submission.team_id not in teams_of_ranked]
            assert [entry.evaluation_id for entry in entries if entry.rank] == ranked
            assert [entry.rank for entry in entries[: len(ranked)]] == list(range(1, len(ranked) + 1))
            assert [entry.evaluation_id for entry in entries if not entry.rank] == best_by_the_rule(others, task)
            shown = places(session, Board(track=TRACK))[task]
            assert {found: (place.rank, place.of) for found, place in shown.items()} == {
                session.get_one(Evaluation, found).submission_id: (rank, len(ranked))
                for rank, found in enumerate(ranked, start=1)
            }
        session.rollback()


@pytest.fixture(scope="module")
def address_of_many_results() -> Iterator[str]:
    """A database with ten teams of a hundred results each, which takes seconds to fill."""
    with fresh_database() as address:
        database = Database(address)
        with database.transaction() as session:
            teams = [Team(name=f"Team {number}", name_key=f"team {number}") for number in range(10)]
            session.add_all(teams)
            for number in range(1000):
                played = {TASK: make_score(number % 97), LOCK: make_score(number % 89)}
                add_result(session, number, teams[number % 10], played, BEGIN + timedelta(seconds=number))
        with database.transaction() as session:
            session.execute(text("ANALYZE"))
        database.dispose()
        yield address


@pytest.fixture
def many_results(address_of_many_results: str) -> Iterator[Database]:
    """A copy of it, which a test may change."""
    with copied_database(address_of_many_results) as database:
        yield database


@pytest.mark.slow
def test_boards_read_the_best_of_each_team_and_not_all_results(many_results: Database) -> None:
    for read in (
        lambda session: leaderboard(session, shown_stage(session, TRACK)),
        lambda session: leaderboard(session, shown_stage(session, TRACK), task=TASK),
        lambda session: log_boards(session, shown_stage(session, TRACK)),
        lambda session: places(session, Board(track=TRACK)),
    ):
        with many_results.transaction() as session, database_work(session) as work:
            read(session)
        assert work.rows_read["evaluations"] < 50
        assert work.rows_read["submissions"] <= 50
        assert work.rows_read["board_results"] < 100
        assert work.statements <= 14, (
            "five ask for the competition, a change, remote plays, and whether names are hidden"
        )


def test_as_long_as_nothing_changes_boards_and_places_cost_one_small_statement(many_results: Database) -> None:
    with many_results.transaction() as session:
        first = (
            places(session, Board(track=TRACK)),
            leaderboard(session, shown_stage(session, TRACK)).view,
            log_boards(session, shown_stage(session, TRACK)).view,
        )
    with many_results.transaction() as session, database_work(session) as work:
        found = places(session, Board(track=TRACK))
    assert (work.statements, work.rows_read["board_results"]) == (1, 0)
    best = {place.rank: submission for submission, place in found[TASK].items()}
    with many_results.transaction() as session, database_work(session) as work:
        again = (
            places(session, Board(track=TRACK)),
            leaderboard(session, shown_stage(session, TRACK)).view,
            log_boards(session, shown_stage(session, TRACK)).view,
        )
        entries = best_entries(session, Board(track=TRACK, task=TASK))
    assert again == first
    assert work.rows_read["board_results"] <= 2 * 10, "those of the last call, which keeps nothing"
    with many_results.reading() as session:
        stage = shown_stage(session, TRACK)
        with database_work(session) as work:
            leaderboard(session, stage)
    assert work.statements == 1, "a page asks once whether anything has changed, for entries and baselines"
    assert best == {entry.rank: entry.submission_id for entry in entries}


def test_a_new_entry_is_all_that_is_read_for_a_board_that_was_made_before(many_results: Database) -> None:
    with many_results.transaction() as session:
        before = leaderboard(session, shown_stage(session, TRACK)).view
        team = session.scalars(select(Team).where(Team.name == "Team 3")).one()
        add_result(session, 1000, team, {TASK: make_score(99), LOCK: make_score(99)}, BEGIN)
    with many_results.transaction() as session, database_work(session) as work:
        after = leaderboard(session, shown_stage(session, TRACK)).view
    assert work.rows_read["evaluations"] <= 1
    assert [entry.rank for entry in after.entries] == list(range(1, 11))
    assert [entry.team for entry in after.entries] == [
        "Team 3",
        *(entry.team for entry in before.entries if entry.team != "Team 3"),
    ]
    with many_results.transaction() as session:
        standings._made_boards._made.clear()
        anew = leaderboard(session, shown_stage(session, TRACK)).view
    assert after.model_copy(update={"generated_at": anew.generated_at}) == anew
