from datetime import UTC, datetime, timedelta
from uuid import UUID

from hypothesis import given
from hypothesis import strategies as st
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from vitac.evaluator.scoring.ranking import Standing, rank
from vitac.server.competition.definition import DEFAULT_RANKING
from vitac.server.db.engine import Database
from vitac.server.db.models import BoardResult
from vitac.server.leaderboards.rank_history import TEAMS, _follow
from vitac.server.leaderboards.shown import shown_rank_history
from vitac.server.principals import VISITOR

BEGIN = datetime(2031, 1, 1, tzinfo=UTC)


def test_each_change_of_a_rank_is_there_under_the_teams_present_entry(database: Database) -> None:
    entered = (("Ants", 50), ("Bees", 80), ("Ants", 60), ("Ants", 90))
    with database.transaction() as session:
        by = {team: make_principal(session, team) for team in ("Ants", "Bees")}
        for number, (team, successes) in enumerate(entered):
            last = submit_scored(session, by[team], f"model {number}", {TASK: make_score(successes)}).id
    with database.transaction() as session:
        ants, bees = shown_rank_history(session, VISITOR, TRACK, task=TASK)
    assert (ants.team, ants.submission_id, [one.rank for one in ants.ranks]) == ("Ants", last, [1, 2, 1])
    assert (bees.team, [one.rank for one in bees.ranks]) == ("Bees", [1, 2])


@given(st.lists(st.tuples(st.integers(0, 9), st.sampled_from([0.0, 0.5, 1.0]), st.sampled_from([None, 2.0, 3.0]))))
def test_the_last_ranks_are_those_of_the_board(entered: list[tuple[int, float, float | None]]) -> None:
    results = [
        BoardResult(
            evaluation_id=UUID(int=number), team_id=UUID(int=team), success_rate=success_rate, mean_steps=mean_steps,
            submitted_at=BEGIN + timedelta(hours=number), finished_at=BEGIN + timedelta(hours=number),
        )
        for number, (team, success_rate, mean_steps) in enumerate(entered)
    ]  # fmt: skip
    ranked = rank(
        Standing(
            id=str(one.evaluation_id), success_rate=one.success_rate, mean_steps=one.mean_steps,
            submitted_at=one.submitted_at,
        )
        for one in results
    )  # fmt: skip
    team_of = {str(one.evaluation_id): one.team_id for one in results}
    best: dict[UUID, str] = {}
    for each in ranked:
        best.setdefault(team_of[each.standing.id], each.standing.id)
    places = {str(each): ranks[-1].rank for each, ranks in _follow(results, DEFAULT_RANKING).items()}
    assert places == {each: place for place, each in enumerate(list(best.values())[:TEAMS], start=1)}
