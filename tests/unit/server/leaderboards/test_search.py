from datetime import UTC, date, datetime, timedelta

import pytest
from page_fixtures import a_leaderboard, a_score, an_entry, some_log_boards
from vitac.evaluator.tracks import load_track
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.baselines import list_examples
from vitac.server.leaderboards.reading import BoardSearch, ShownRows

NOON = datetime(2026, 3, 31, 12, tzinfo=UTC)
SCORE = a_score((80, 74, 80), 4.92)
BOARD = a_leaderboard(
    *(
        an_entry(rank, team, SCORE).model_copy(update={"submitted_at": NOON + timedelta(hours=hours)})
        for rank, (team, hours) in enumerate((("Bears", -13), ("Gelbots", 0), ("Bears II", 13)), 1)
    )
).model_copy(update={"baselines": list_examples(load_track("track_1"), "peg-insertion")})


@pytest.mark.parametrize(
    ("query", "ranks", "baselines"),
    [
        ({}, [1, 2, 3], 2),
        ({"q": "bEARs"}, [1, 3], 0),
        ({"since": "2026-03-31"}, [2, 3], 0),
        ({"until": "2026-03-31"}, [1, 2], 0),
        ({"since": "2026-03-31", "until": "2026-03-31"}, [2], 0),
        ({"q": "bears", "since": "2026-04-01"}, [3], 0),
        ({"rows": "entries"}, [1, 2, 3], 0),
        ({"rows": "baselines"}, [], 2),
        ({"q": "nobody"}, [], 0),
    ],
)
def test_rows_are_found_under_their_ranks_on_the_whole_board(
    query: dict[str, str], ranks: list[int], baselines: int
) -> None:
    shown = BoardSearch.read(query).apply(BOARD)
    assert [entry.rank for entry in shown.entries] == ranks
    assert (len(shown.baselines), shown.teams) == (baselines, 3)


def test_the_query_of_a_search_reads_as_the_same_search() -> None:
    search = BoardSearch(team="Söhne & 7", since=date(2026, 1, 1), until=date(2026, 2, 28), rows=ShownRows.ENTRIES)
    assert BoardSearch.read(dict(search.query())) == search
    assert BoardSearch.read({"q": "  ", "since": "", "rows": ""}).is_empty


@pytest.mark.parametrize("query", [{"since": "31.3."}, {"until": "2026-02-30"}, {"rows": "some"}])
def test_what_cannot_be_read_is_named(query: dict[str, str]) -> None:
    [(name, value)] = query.items()
    with pytest.raises(ServiceError, match=f"as {name}, got '{value}'") as error:
        BoardSearch.read(query)
    assert error.value.code is ProblemCode.INVALID_REQUEST


def test_logs_are_searched_in_all_boards() -> None:
    found = some_log_boards()
    team = found.boards[0].entries[0].team
    shown = BoardSearch(team=team).apply_to_logs(found)
    assert {entry.team for board in shown.boards for entry in board.entries} == {team}
    assert all(team in log.team for log in shown.text_logs)
