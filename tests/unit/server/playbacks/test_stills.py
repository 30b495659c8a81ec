from datetime import UTC, datetime
from uuid import UUID, uuid4

import pytest
from asked_playbacks import SETTINGS, Played, played
from service_factories import TASK, play, sha256, shard_ids
from sqlalchemy import func, select
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Playback
from vitac.server.database.states import WorkState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.playbacks import stills
from vitac.server.playbacks.stills import ask_for_missing_stills, find_stills, list_stills
from vitac.server.principals import VISITOR

NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)


def draw(team: Played, number: int) -> None:
    """Has the playback of an episode made, with a still."""
    asked = team.ask(number)
    running = {"state": WorkState.RUNNING, "worker_id": uuid4(), "lease_expires_at": NOW}
    files = {"scene_sha256": sha256("scene"), "still_sha256": sha256("still")}
    made = {"state": WorkState.DONE, "lease_expires_at": None, "finished_at": NOW, **files}
    with team.database.transaction() as session:
        for values in (running, made):
            found = session.get_one(Playback, asked.id)
            for name, value in values.items():
                setattr(found, name, value)
            session.flush()


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


def test_a_list_shows_the_first_still_of_each_submission_to_whom_it_may_be(database: Database, team_a: Played) -> None:
    other = played(database, "Team B", "other content")
    both = [team_a.submission.id, other.submission.id]
    for number in (3, 2):
        draw(team_a, number)
        with database.transaction() as session:
            found = find_stills(session, team_a.by, both)
            assert {submission: still.episode for submission, still in found.items()} == {both[0]: number}
            assert find_stills(session, VISITOR, both) == {}


def test_the_first_success_and_the_first_failure_of_public_results_are_asked_for_once(
    database: Database, team_a: Played
) -> None:
    other = played(database, "Team B", "other content")
    for team in (team_a, other):
        play_the_rest(team)
    seen: set[UUID] = set()
    with database.transaction() as session:
        set_public(session, team_a.by, team_a.submission.id, public=True)
        ask_for_missing_stills(session, SETTINGS, seen)
    solved = {number: team_a.episode(number).success for number in range(1, 16)}
    firsts = {min(number for number in solved if solved[number] is end) for end in set(solved.values())}
    assert len(seen) == 1
    assert asked_for(database) == {(team_a.submission.digest, number) for number in firsts}
    with database.transaction() as session:
        ask_for_missing_stills(session, SETTINGS, set())
        assert session.scalar(select(func.count()).select_from(Playback)) == len(firsts)


def test_results_wait_for_their_turn_and_one_without_a_playback_holds_up_no_other(
    database: Database, team_a: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stills, "ASKED_AT_ONCE", 1)
    other = played(database, "Team B", "other content")
    seen: set[UUID] = set()
    with database.transaction() as session:
        for team in (team_a, other):
            set_public(session, team.by, team.submission.id, public=True)
    for team in (team_a, other):  # the other one ends last, and so comes first
        play_the_rest(team)
    monkeypatch.setattr(stills, "ask", refuse)
    with database.transaction() as session:
        ask_for_missing_stills(session, SETTINGS, seen)
    monkeypatch.undo()
    with database.transaction() as session:
        ask_for_missing_stills(session, SETTINGS, seen)
    assert {digest for digest, _ in asked_for(database)} == {team_a.submission.digest}


def asked_for(database: Database) -> set[tuple[str, int]]:
    with database.transaction() as session:
        rows = select(EpisodeResult.submission_digest, EpisodeResult.episode).join(Playback)
        return {(digest, number) for digest, number in session.execute(rows)}


def play_the_rest(team: Played) -> None:
    with team.database.transaction() as session:
        _, *rest = shard_ids(session, team.submission)
    for shard in rest:
        play(team.database, shard)


def refuse(*_: object) -> None:
    """There is no playback of any episode."""
    raise ServiceError(ProblemCode.INVALID_REQUEST, "There is none.")
