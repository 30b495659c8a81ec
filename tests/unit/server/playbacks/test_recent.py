from collections.abc import Collection
from datetime import UTC, datetime, timedelta
from uuid import UUID, uuid4

import pytest
from asked_playbacks import SETTINGS, Played, played
from service_factories import TASK, complete_scored, make_score, sha256
from sqlalchemy import update
from sqlalchemy.orm import Session
from vitac.server.database.models import EpisodeResult, Playback, Submission
from vitac.server.database.states import WorkState
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.playbacks import stills
from vitac.server.playbacks.stills import newest_public_episode
from vitac.server.views.comparisons import PublicEpisodeView

NOW = datetime(2026, 11, 22, 12, tzinfo=UTC)


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
