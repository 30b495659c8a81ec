from datetime import UTC, datetime, timedelta
from uuid import UUID

from hypothesis import given
from hypothesis import strategies as st
from service_factories import TASK, TRACK, make_principal, make_score, submit_scored
from vitac.server.database.engine import Database
from vitac.server.database.models import BoardResult
from vitac.server.leaderboards.history import TEAMS, _follow
from vitac.server.leaderboards.reading import shown_rank_history
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


@given(st.lists(st.tuples(st.integers(0, 9), st.sampled_from([0.0, 0.5, 1.0]))))
def test_the_last_ranks_are_those_of_the_board(entered: list[tuple[int, float]]) -> None:
    results = [
        BoardResult(
            evaluation_id=UUID(int=number),
            team_id=UUID(int=team),
            sort_key=[-success_rate],
            finished_at=BEGIN + timedelta(hours=number),
        )
        for number, (team, success_rate) in enumerate(entered)
    ]
    best: dict[UUID, UUID] = {}
    for result in sorted(results, key=lambda result: (result.sort_key, result.evaluation_id)):
        best.setdefault(result.team_id, result.evaluation_id)
    places = {each: ranks[-1].rank for each, ranks in _follow(results).items()}
    assert places == {each: place for place, each in enumerate(list(best.values())[:TEAMS], start=1)}
