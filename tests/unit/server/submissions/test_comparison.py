from uuid import uuid4

import pytest
from service_factories import LOCK, TASK, make_principal, make_score, make_settings, submit_scored
from vitac.evaluator.tracks import load_track
from vitac.server.database.engine import Database
from vitac.server.errors import ServiceError
from vitac.server.principals import VISITOR
from vitac.server.submissions.comparison import MAX_COMPARED, compare_results, quarters_of_starts


def test_of_a_submission_that_somebody_may_not_see_what_boards_show_is_compared(database: Database) -> None:
    with database.transaction() as session:
        first, second = make_principal(session, "Team A"), make_principal(session, "Team B")
        own = submit_scored(session, first, "own", {TASK: make_score(50), LOCK: make_score(60, 160, 9.0)}).id
        other = submit_scored(session, second, "other", {LOCK: make_score(100, 160)}).id
        worse = submit_scored(session, second, "worse", {LOCK: make_score(10, 160)}).id
    with database.transaction() as session:
        found = compare_results(session, make_settings(), first, [own, other, own])
        assert [(one.team, one.has_page, one.episodes) for one in found.results] == [
            ("Team A", True, 0), ("Team B", False, 0),
        ]  # fmt: skip
        assert [score.task for score in found.results[1].scores] == [LOCK]
        assert found.pairs == []
        assert [one.has_page for one in compare_results(session, make_settings(), VISITOR, [own]).results] == [False]
        for hidden in ([worse], [own, worse]):
            with pytest.raises(ServiceError, match="submission"):
                compare_results(session, make_settings(), first, hidden)


def test_so_much_is_compared_at_once(database: Database) -> None:
    with (
        database.transaction() as session,
        pytest.raises(ServiceError, match="at most 8 submissions to compare, got 9"),
    ):
        compare_results(session, make_settings(), VISITOR, [uuid4() for _ in range(MAX_COMPARED + 1)])


def test_starts_of_a_task_are_in_four_groups_by_their_distance_all_repeats_in_one() -> None:
    quarters, episodes = (
        quarters_of_starts("track_1", "peg-insertion"),
        load_track("track_1").task("peg-insertion").episodes,
    )
    by_start = {episode.offset: quarters[episode.number] for episode in episodes}
    assert all(quarters[episode.number] == by_start[episode.offset] for episode in episodes)
    counts = [list(by_start.values()).count(quarter) for quarter in range(4)]
    assert max(counts) - min(counts) <= 1
    assert by_start[(-4, -4, -8)] == 3
    assert quarters_of_starts("maniskill", next(iter(load_track("maniskill").tasks))) == {}
