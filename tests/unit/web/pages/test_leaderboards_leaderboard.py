from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

import pytest
from page_fixtures import TASK, a_leaderboard, a_score, an_entry
from vitac.evaluator.ranking import make_ranking
from vitac.evaluator.tracks import load_track
from vitac.server.database.states import Role
from vitac.server.principals import Principal
from vitac.web.pages.leaderboards import _dates, row_key
from vitac.web.site import Viewer


def viewer(**principal: Any) -> Viewer:
    return Viewer(principal=Principal(**principal), form_token="", expires_at=datetime.now(UTC))


def test_rows_are_kept_apart_for_those_who_see_them_differently() -> None:
    """A kept row with a link to a submission, or marked as one's own, must not be shown to others."""
    entry: Any = SimpleNamespace(team="Gripper", submission_id=uuid4())
    own = viewer(role=Role.TEAM, team_name="Gripper", team_id=uuid4())
    other = viewer(role=Role.TEAM, team_name="Other", team_id=uuid4())
    organizer = viewer(role=Role.ORGANIZER)
    keys = [row_key(entry, who, ()) for who in (own, other, organizer, None)]
    assert len(set(keys)) == 3
    assert keys[1] == keys[3], "who sees the same shares the row"
    assert row_key(entry, None, {entry.submission_id}) == keys[2]


@pytest.mark.parametrize(
    ("ranking", "title", "shown"),
    [
        (["success_rate", "submitted_at"], "Success rate against date", "45.2"),
        (["mean_steps", "submitted_at"], "Mean env steps against date", "4.2"),
        (["surface_diff_mm", "submitted_at"], "Surface [mm] against date", "0.75"),
        (["submitted_at"], "Success rate against date", "45.2"),
    ],
)
def test_plot_against_dates_shows_what_the_board_compares_first(ranking: list[str], title: str, shown: str) -> None:
    measures = load_track("track_1").tasks[TASK].definition.measures
    entries = [
        an_entry(rank, team, a_score((41, 41, 40), 4.2), task=TASK).model_copy(update={"measures": measured})
        for rank, team, measured in (
            (1, "A", {"surface_diff_mm": 0.75}),
            (2, "B", {"surface_diff_mm": 0.9}),
            (3, "C", {}),
        )
    ]
    board = a_leaderboard(*entries, task=TASK).model_copy(update={"ranking": make_ranking(ranking, measures)})
    site: Any = SimpleNamespace(plots=SimpleNamespace(get=lambda _, make: make()))
    figure = _dates(site, board, ())
    assert figure is not None
    assert figure.title == title
    assert shown in figure.summary
    assert len(figure.table.rows) == (2 if "surface_diff_mm" in ranking else 3), "one has no such mean"
