"""Pages of a final on stations: places, trials with video and help, results in complete blocks, the live picture."""

from datetime import timedelta
from pathlib import Path

import pytest
from seeded_site import SeededSite
from service_factories import play_within
from sqlalchemy import select
from station_final import ADDRESS, DIGEST, PLAYED, STARTS, STATION, TEAMS, VIDEO, hold_final, play, record_of, stage_of
from vitac.evaluator.episodes.records import (
    EpisodeOutcome,
)
from vitac.server.database.clock import read_clock
from vitac.server.database.models import LivePicture, Station, Submission, Trial
from vitac.server.decisions import station_trials
from vitac.server.decisions.station_trials import planned_trials, store_picture, summarize
from vitac.server.evaluations.lifecycle import cancel
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.queue.work import find_station


@pytest.fixture
def final(site: SeededSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Principal]:
    return hold_final(site, tmp_path, monkeypatch)


def test_teams_see_their_own_places_and_trials_and_nobody_those_of_others(
    site: SeededSite, final: dict[str, Principal]
) -> None:
    play(site, first_blocks=1)
    with stage_of(site) as (session, stage):
        own = {trial.evaluation.submission.team.name: trial for trial in planned_trials(session, stage)[: len(TEAMS)]}
        addresses = {
            name: f"/submissions/{trial.evaluation.submission_id}/trials/{PLAYED}/{trial.episodes[0]}"
            for name, trial in own.items()
        }
    ants, visitor = site.team_visitor("Ants"), site.visitor()
    places = ants.get(ADDRESS).text
    assert places.count("<bdi>Ants: ") == STARTS
    assert "Bees" not in places
    assert addresses["Ants"] in places
    assert "3 of 12 trials are over" in visitor.get(ADDRESS).text
    assert "Ants" not in visitor.get(ADDRESS).text
    trial = ants.get(addresses["Ants"]).text
    assert "The task was solved. 2 env steps at station" in trial
    assert 'data-moment="4"' in trial
    assert "Pause, 31 s, 2 s before the trial’s begin: <bdi>&lt;b&gt;cable&lt;/b&gt;</bdi>" in trial
    for path in (addresses["Bees"], f"{addresses['Bees']}/video"):
        for browser in (ants, visitor):
            assert browser.get(path).status_code == (404 if browser is ants else 303)
    assert visitor.get(f"/api/v1{addresses['Ants']}").status_code in {401, 404}


def test_every_page_says_of_a_twin_that_it_is_one_and_of_results_what_they_were_played_on(
    site: SeededSite, final: dict[str, Principal]
) -> None:
    twin, other = "a twin of class B, no hardware", "a twin of class A, no hardware"
    play(site, first_blocks=1, twin=twin)
    with site.database.transaction() as session:
        session.get_one(Station, "east").twin = other
    with stage_of(site) as (session, stage):
        trials = planned_trials(session, stage)
        at = [find_station(trial.requires) for trial in trials]
        ants = next(trial for trial in trials if trial.evaluation.submission.team.name == "Ants")
        submission = f"/submissions/{ants.evaluation.submission_id}"
        views = station_trials.list_trials(session, CONSOLE, stage)
    assert [each.twin for each in views] == [twin] * len(TEAMS) + [
        other if station == "east" else None for station in at[len(TEAMS) :]
    ]
    browser = site.team_visitor("Ants")
    page = browser.get(ADDRESS).text
    assert f"Station east: {other}</span>" in page
    assert "Station west</span>" in page
    assert f'<span class="sub">{twin}</span>' in page
    assert f"({twin}), from cuboid" in browser.get(f"{submission}/trials/{PLAYED}/{ants.episodes[0]}").text
    play(site)
    with stage_of(site) as (session, stage):
        results = summarize(session, VISITOR, stage)
    assert results is not None
    assert [(each.station, each.twin, each.episodes) for each in results.stations] == [
        (station, kind, count)
        for station in ("east", "west")
        for kind, count in (
            (None, at[len(TEAMS) :].count(station)),
            (twin, at[: len(TEAMS)].count(station)),
        )
        if count
    ]
    sentence = f"Played on twins: 1 of {STARTS} trials on {twin}."
    assert sentence in browser.get(submission).text
    assert sentence in browser.get(f"/compare?id={ants.evaluation.submission_id}").text
    board = site.visitor().get(f"/competitions/cup/tracks/{STATION}").text
    assert f"Played on twins: {len(TEAMS)} of {len(TEAMS) * STARTS} trials on {twin}." in board


def test_video_of_a_trial_is_handed_to_its_team_as_it_was_stored(
    site: SeededSite, final: dict[str, Principal], tmp_path: Path
) -> None:
    play(site, first_blocks=1)
    with site.database.transaction() as session:
        trial = session.scalars(select(Trial).join(Trial.evaluation).join(Submission).where(
            Submission.team_id == final["Ants"].team_id, Trial.state == "done")).one()  # fmt: skip
        address = f"/submissions/{trial.evaluation.submission_id}/trials/{PLAYED}/{trial.episodes[0]}/video"
    browser = site.team_visitor("Ants")
    assert browser.get(address).status_code == 503, "its file is lost, which is no missing page"
    (tmp_path / "video").write_bytes(VIDEO)
    site.services.blobs.put(tmp_path / "video", DIGEST)
    assert browser.get(address).content == VIDEO


def test_results_compare_complete_blocks_and_stations_once_the_trials_are_over(
    site: SeededSite, final: dict[str, Principal]
) -> None:
    play(site, first_blocks=2)
    with stage_of(site) as (session, stage):
        assert summarize(session, VISITOR, stage) is None
        next_trial = planned_trials(session, stage)[2 * len(TEAMS)]
        play_within(session, next_trial.id, record_of(EpisodeOutcome.TACTILE))
        for evaluation in {trial.evaluation for trial in planned_trials(session, stage)}:
            cancel(session, evaluation)
    with stage_of(site) as (session, stage):
        results = summarize(session, VISITOR, stage)
        places = planned_trials(session, stage)
        at = [find_station(trial.requires) for trial in places[: 2 * len(TEAMS) + 1]]
    assert results is not None
    assert (results.blocks, results.trials_left_out) == (2, 1)
    for each in results.differences:
        assert abs(each.difference) == (1.0 if "Ants" in each.first + each.second else 0.0)
    assert {each.station: each.episodes for each in results.stations} == {name: at.count(name) for name in set(at)}
    assert [each.effect for each in results.stations] == [0.0, 0.0], "each team is the same at both"
    page = site.visitor().get(ADDRESS).text
    assert "2 blocks are complete. 1 trial of other blocks is left out here" in page


def test_block_with_a_start_that_one_station_replaced_is_left_out(
    site: SeededSite, final: dict[str, Principal]
) -> None:
    with stage_of(site) as (session, stage):
        replaced = record_of(EpisodeOutcome.SUCCESS, initial_offset=(9.0, 9.0, 9.0))
        play_within(session, planned_trials(session, stage)[0].id, replaced)
    play(site)
    with stage_of(site) as (session, stage):
        results = summarize(session, VISITOR, stage)
    assert results is not None
    assert (results.blocks, results.trials_left_out) == (STARTS - 1, len(TEAMS))
    assert sum(each.episodes for each in results.stations) == STARTS * len(TEAMS)


def test_everybody_watches_later_by_the_delay_and_reads_no_name(site: SeededSite, final: dict[str, Principal]) -> None:
    with site.database.transaction() as session:
        trial = session.scalars(select(Trial).order_by(Trial.turn)).first()
        assert trial is not None
        trial.code = "0123456789ABCDEF"
        assert not store_picture(session, "east", "F" * 16, b"of no trial")
        assert store_picture(session, "east", "0123456789ABCDEF", b"now")
    live = ADDRESS.replace("/trials", "/live/east")
    visitor = site.visitor()
    assert visitor.get(live).status_code == 404
    with site.database.transaction() as session:
        picture = session.scalars(select(LivePicture)).one()
        names = {"competition": picture.competition, "track": picture.track, "stage": picture.stage}
        session.delete(picture)
        for age_s in (65, 61, 30):
            taken_at = read_clock(session) - timedelta(seconds=age_s)
            session.add(LivePicture(station="east", picture=f"{age_s} s ago".encode(), taken_at=taken_at, **names))
    assert visitor.get(live).content == b"61 s ago"
    assert visitor.get(live.replace("east", "west")).status_code == 404
    assert "What the stations’ cameras saw 1 min 00 s ago" in visitor.get(ADDRESS).text
