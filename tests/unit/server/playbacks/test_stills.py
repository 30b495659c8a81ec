from collections.abc import Collection
from datetime import UTC, datetime, timedelta
from uuid import UUID, uuid4

import pytest
from asked_playbacks import SETTINGS, Played, played
from service_factories import TASK, complete_scored, make_score, play, sha256, shard_ids
from sqlalchemy import func, select, update
from sqlalchemy.orm import Session
from vitac.server.database.engine import Database
from vitac.server.database.models import EpisodeResult, Playback, Submission
from vitac.server.database.states import WorkState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.playbacks import stills
from vitac.server.playbacks.stills import ask_for_missing_stills, find_stills, list_stills, newest_public_episode
from vitac.server.principals import VISITOR
from vitac.server.views.comparisons import PublicEpisodeView

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


def make(team: Played, number: int, minutes: int, *, is_made: bool = True, file: str = "scene_sha256") -> None:
    """Has the playback of an episode asked for at some minute, and made."""
    playback = team.ask(number)
    running = {"state": WorkState.RUNNING, "worker_id": uuid4(), "lease_expires_at": NOW}
    made = {"state": WorkState.DONE, "lease_expires_at": None, file: sha256("file"), "finished_at": NOW}
    with team.database.transaction() as session:
        for values in ({"asked_at": NOW + timedelta(minutes=minutes)}, *((running, made) if is_made else ())):
            found = session.get_one(Playback, playback.id)
            for name, value in values.items():
                setattr(found, name, value)
            session.flush()


def show(team: Played, *, public: bool = True) -> None:
    """Makes a submission public or private."""
    with team.database.transaction() as session:
        set_public(session, team.by, team.submission.id, public=public)


def complete(team: Played) -> None:
    with team.database.transaction() as session:
        complete_scored(session, session.get_one(Submission, team.submission.id), {TASK: make_score(80)})


def newest(team: Played) -> PublicEpisodeView | None:
    with team.database.transaction() as session:
        return newest_public_episode(session, SETTINGS)


def number_of(found: PublicEpisodeView | None) -> int | None:
    return None if found is None else found.shown.episode


def test_the_newest_playback_of_a_complete_public_submission_is_shown(team_a: Played) -> None:
    assert newest(team_a) is None
    make(team_a, 2, minutes=1)
    show(team_a)
    assert newest(team_a) is None, "its evaluation is not complete"
    complete(team_a)
    found = newest(team_a)
    assert found is not None
    assert (found.submission_id, found.shown.task, found.shown.episode) == (team_a.submission.id, TASK, 2)
    assert found.shown.playback is not None
    assert found.shown.playback.state is WorkState.DONE
    make(team_a, 3, minutes=2)
    make(team_a, 1, minutes=0)
    make(team_a, 4, minutes=3, is_made=False)
    assert number_of(newest(team_a)) == 3
    show(team_a, public=False)
    assert newest(team_a) is None


def test_a_later_playback_of_a_private_submission_is_passed_over(team_a: Played) -> None:
    private = played(team_a.database, "Team B", "other content")
    for team in (team_a, private):
        complete(team)
    show(team_a)
    make(team_a, 1, minutes=0)
    make(private, 2, minutes=1)
    found = newest(team_a)
    assert found is not None
    assert (found.shown.team, found.shown.episode) == ("Team A", 1)


def test_playbacks_that_pages_no_longer_find_are_passed_over(team_a: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    complete(team_a)
    show(team_a)
    make(team_a, 1, minutes=0)
    make(team_a, 2, minutes=1)
    with team_a.database.transaction() as session:
        session.execute(update(Playback).where(Playback.episode_id == team_a.episode(2).id).values(key=sha256("older")))
    assert number_of(newest(team_a)) == 1, "the other one has another format"
    monkeypatch.setattr(stills, "LOOKED_AT", 1)
    assert newest(team_a) is None
    monkeypatch.setattr(stills, "LOOKED_AT", 100)
    monkeypatch.setattr(stills, "current_versions", lambda: frozenset({"2+other"}))
    assert newest(team_a) is None


def test_a_submission_that_becomes_private_meanwhile_is_passed_over(
    team_a: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    complete(team_a)
    make(team_a, 1, minutes=0)
    show(team_a)
    assert number_of(newest(team_a)) == 1

    def privately(session: Session, submissions: Collection[UUID]) -> Collection[UUID]:
        session.execute(update(Submission).where(Submission.id.in_(submissions)).values(is_public=False))
        return submissions

    monkeypatch.setattr(stills, "public_among", privately)
    assert newest(team_a) is None


def test_films_are_not_played_on_the_front_page(team_a: Played) -> None:
    complete(team_a)
    show(team_a)
    make(team_a, 1, minutes=1)
    make(team_a, 2, minutes=2, file="film_sha256")
    assert number_of(newest(team_a)) == 1


def test_what_failed_is_not_what_the_front_page_plays(team_a: Played) -> None:
    for number in (2, 3):
        make(team_a, number, minutes=number)
    show(team_a)
    complete(team_a)
    with team_a.database.transaction() as session:
        failed = {"success": False, "outcome": "tactile"}
        session.execute(update(EpisodeResult).where(EpisodeResult.episode == 3).values(**failed))
    assert number_of(newest(team_a)) == 2
