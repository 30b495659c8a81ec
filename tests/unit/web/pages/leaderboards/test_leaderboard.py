from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any
from uuid import uuid4

from vitac.server.database.states import Role
from vitac.server.principals import Principal
from vitac.web.pages.leaderboards.leaderboard import row_key
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
