from datetime import UTC, datetime

import pytest
from asked_playbacks import SETTINGS, Played
from service_factories import TASK, sha256
from sqlalchemy import update
from vitac.server.db.models import Playback
from vitac.server.db.states import PlaybackState
from vitac.server.errors import ServiceError
from vitac.server.playbacks.stills import ask_for_stills, list_stills
from vitac.server.principals import CONSOLE, VISITOR

NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)


def draw(team: Played, number: int) -> None:
    """Has the playback of an episode made, with a still."""
    asked = team.ask(number)
    running = {"state": PlaybackState.RUNNING, "lease_expires_at": NOW}
    files = {"scene_sha256": sha256("scene"), "still_sha256": sha256("still")}
    made = {"state": PlaybackState.MADE, "lease_expires_at": None, "finished_at": NOW, **files}
    with team.database.transaction() as session:
        for values in (running, made):
            session.execute(update(Playback).where(Playback.id == asked.id).values(**values))


def test_the_first_episode_of_each_end_that_has_a_still_is_shown_to_whom_it_may_be(team_a: Played) -> None:
    team_a.ask(1)
    for number in (3, 2):
        draw(team_a, number)
    with team_a.database.transaction() as session:
        [still] = list_stills(session, team_a.by, team_a.submission.id)
        assert (still.task, still.episode, still.outcome) == (TASK, 2, "success")
        assert len(still.key) == 64
        with pytest.raises(ServiceError):
            list_stills(session, VISITOR, team_a.submission.id)


def test_the_first_success_and_the_first_failure_are_asked_for(team_a: Played) -> None:
    with team_a.database.transaction() as session:
        ask_for_stills(session, SETTINGS, CONSOLE, team_a.submission.id)
    solved = {number: team_a.episode(number).success for number in range(1, 16)}
    firsts = {min(number for number in solved if solved[number] is end) for end in set(solved.values())}
    assert {number for number in solved if team_a.found(number)} == firsts
