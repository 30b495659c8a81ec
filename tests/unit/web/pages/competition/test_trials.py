"""Pages of a final on stations: places, trials with video and help, results in complete blocks, the live picture."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import yaml
from evaluation_records import make_record
from seeded_site import SeededSite
from service_factories import TRACK, make_principal, make_upload, play_within
from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.envs.geometry.pegs import PegShape
from vitac.evaluator.episodes.records import (
    EpisodeOutcome,
    EpisodeRecord,
    HelpKind,
    HumanHelp,
    TrialEvidence,
    TrialVideo,
)
from vitac.server.accounts import stations
from vitac.server.competitions.applying import apply
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import CompetitionDefinition
from vitac.server.competitions.stages import Stage
from vitac.server.database.clock import read_clock
from vitac.server.database.models import LivePicture, Submission, SubmissionFile, Trial
from vitac.server.database.states import FileRole
from vitac.server.decisions.live_trials import store_picture
from vitac.server.decisions.trial_plan import begin, planned_trials
from vitac.server.decisions.trial_results import summarize
from vitac.server.evaluations.lifecycle import cancel
from vitac.server.principals import CONSOLE, VISITOR, Principal
from vitac.server.queue.work import find_station
from vitac.server.submissions import creation
from vitac.station.description import make_station_track

from competitions import FIRST, make_competition, moved, open_now, put_in_place

STATION, PLAYED, STARTS = "station", "peg-insertion-station", 4
TEAMS = ("Ants", "Bees", "Controls")
VIDEO = b"frames"
DIGEST = sha256(VIDEO).hexdigest()


def cup() -> dict[str, Any]:
    content = open_now(make_competition())
    rules = content["tracks"].pop(TRACK)
    plan = {"stations": ["east", "west"], "control": "Controls", "live_delay_s": 60}
    stage = rules["stages"][0] | {"accepts": ["model"], "list": "sealed", "sealed": "at_once", "plan": plan}
    content["tracks"][STATION] = rules | {"stages": [stage]}
    return content


@pytest.fixture
def final(site: SeededSite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Principal]:
    """A final whose trials have begun: three teams, four starts, two stations."""
    (tmp_path / f"{STATION}.yaml").write_text(yaml.safe_dump(make_station_track(PegShape.CUBOID, 1, starts=STARTS)))
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))
    with site.database.transaction() as session:
        apply(session, CONSOLE, CompetitionDefinition.model_validate(cup()), confirmed=None)
        for name in ("east", "west"):
            stations.add_station(session, CONSOLE, name)
        teams = {name: make_principal(session, name) for name in TEAMS}
        for name, principal in teams.items():
            upload = make_upload(name, track=STATION, tasks=(PLAYED,), manifest={"track": STATION, "name": "zero"})
            creation.create(session, principal, upload)
        put_in_place(session, moved(cup(), days=-300))
    with stage_of(site) as (session, stage):
        begin(session, CONSOLE, stage)
    return teams


@contextmanager
def stage_of(site: SeededSite) -> Iterator[tuple[Session, Stage]]:
    with site.database.transaction() as session:
        yield session, Competition.read(session).stage(STATION, FIRST)


def record_of(outcome: EpisodeOutcome) -> Any:
    def record(episode: int, *, task: str) -> EpisodeRecord:
        video = TrialVideo(code="0123456789ABCDEF", frames=9, link="a" * 64, sha256=DIGEST, n_bytes=len(VIDEO))
        pause = HumanHelp(kind=HelpKind.PAUSE, at_s=-2.0, length_s=31.0, note="<b>cable</b>")
        measured = {"encoders": [1.0, 2.0, -40.25, 3.0], "movement_px": [0.5, 0.25]}
        return make_record(
            episode,
            outcome,
            env_steps=2,
            task=task,
            shape="cuboid",
            infos=({**measured, "video": {"frame": 4, "link": "b" * 64}}, {}),
            evidence=TrialEvidence(station="twin", video=video, help=(pause,)),
        )

    return record


def play(site: SeededSite, *, first_blocks: int = STARTS) -> None:
    """Ants solve every start, the others none; at each station as the plan says."""
    with stage_of(site) as (session, stage):
        trials = planned_trials(session, stage)[: first_blocks * len(TEAMS)]
        for trial in trials:
            solved = trial.evaluation.submission.team.name == "Ants"
            outcome = EpisodeOutcome.SUCCESS if solved else EpisodeOutcome.TACTILE
            play_within(session, trial.id, record_of(outcome))
            of_trial = {"submission_id": trial.evaluation.submission_id, "role": FileRole.VIDEO, "sha256": DIGEST}
            if session.get(SubmissionFile, tuple(of_trial.values())) is None:
                session.add(SubmissionFile(**of_trial, n_bytes=len(VIDEO), name="trial.mjpeg", facts={}))


ADDRESS = f"/competitions/cup/tracks/{STATION}/stages/{FIRST}/trials"


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
    assert "What the stations’ cameras saw 1.0 minutes ago" in visitor.get(ADDRESS).text
