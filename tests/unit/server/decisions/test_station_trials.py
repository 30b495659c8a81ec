"""A stage that stations play: its trials wait for their plan, and then for the station and turn that it gives them."""

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest
import yaml
from service_factories import TRACK, make_principal, make_settings, submit_to
from sqlalchemy import select
from sqlalchemy.orm import Session
from submission_steps import make_worker, refused, view_of
from vitac.envs.geometry.pegs import PegShape
from vitac.envs.tasks.definition import Family
from vitac.evaluator.strict_model import DocumentRejected
from vitac.evaluator.tracks.trial_plan import draw_plan
from vitac.server.accounts import stations
from vitac.server.competitions.applying import apply
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.definition import CompetitionDefinition, require_known_tracks
from vitac.server.competitions.sealing import find_secret, reveal
from vitac.server.competitions.stages import Stage
from vitac.server.database.clock import read_clock
from vitac.server.database.engine import Database
from vitac.server.database.models import Evaluation, Submission, Trial
from vitac.server.database.states import WorkState
from vitac.server.decisions.station_trials import begin, list_trials
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.lifecycle import cancel
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue.work import claim, sweep
from vitac.server.views.submissions import SubmissionView
from vitac.station.description import make_station_track
from vitac.worker.capabilities import list_abilities

from competitions import FIRST, make_competition, moved, open_now, put_in_place

STATION, PLAYED, STARTS = "station", "peg-insertion-station", 4
TEAMS = ("Ants", "Bees", "Controls")
PLAN = {"stations": ["east", "west"], "control": "Controls"}


def cup(plan: dict[str, Any] | None = PLAN, **of_stage: Any) -> dict[str, Any]:
    content = open_now(make_competition())
    rules = content["tracks"].pop(TRACK)
    stage = rules["stages"][0] | {"accepts": ["model"], "list": "sealed", "sealed": "at_once", "plan": plan} | of_stage
    content["tracks"][STATION] = rules | {"stages": [stage]}
    return content


@pytest.fixture(autouse=True)
def station_track(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    track = make_station_track(PegShape.CUBOID, 1, starts=STARTS)
    (tmp_path / f"{STATION}.yaml").write_text(yaml.safe_dump(track))
    monkeypatch.setenv("VITAC_TRACKS_DIR", str(tmp_path))


@pytest.fixture
def teams(database: Database) -> dict[str, Principal]:
    """A stage on two stations, and a submission of each team to it."""
    with database.transaction() as session:
        apply(session, CONSOLE, CompetitionDefinition.model_validate(cup()))
        for name in PLAN["stations"]:
            stations.add_station(session, CONSOLE, name)
        by_name = {name: make_principal(session, name) for name in TEAMS}
        for principal in by_name.values():
            submit_to(session, principal, track=STATION, task=PLAYED)
    return by_name


@contextmanager
def closed(database: Database) -> Iterator[tuple[Session, Stage]]:
    with database.transaction() as session:
        put_in_place(session, moved(cup(), days=-300))
        yield session, Competition.read(session).stage(STATION, FIRST)


def take(database: Database, station: str | None) -> Trial | None:
    abilities = list_abilities((Family.STATION,), station=station)
    worker = uuid4()
    make_worker(database, id=worker)
    taken = claim(database, make_settings(), worker, abilities)
    with database.transaction() as session:
        return None if taken is None else session.get_one(Trial, taken.work_id)


def view_of_first(database: Database) -> SubmissionView:
    with database.transaction() as session:
        first = session.scalars(select(Submission).limit(1)).one()
    return view_of(database, CONSOLE, first)


def test_trials_wait_until_the_plan_and_then_each_station_plays_its_own_in_order(
    database: Database, teams: dict[str, Principal]
) -> None:
    assert take(database, "east") is None
    assert "wait for the stage's plan" in (view_of_first(database).waits or "")
    with closed(database) as (session, stage):
        assert begin(session, CONSOLE, stage) == STARTS * len(TEAMS)
        planned = list_trials(session, CONSOLE, stage)
        ids = {str(found.id) for found in session.scalars(select(Submission))}
        control = next(str(found.id) for found in session.scalars(select(Submission)) if found.team.name == "Controls")
        sealed = stage.sealed_list
        assert sealed is not None
        drawn = draw_plan(
            find_secret(session, sealed.commitment),
            entries=ids,
            starts={f"{PLAYED} {number}" for number in session.scalars(select(Trial.number))},
            stations=("east", "west"),
            control=control,
        )
    assert [(str(trial.submission_id), trial.station) for trial in planned] == [
        (trial.entry, trial.station) for trial in drawn
    ]
    assert [trial.position for trial in planned] == list(range(1, 13))
    assert view_of_first(database).waits is None
    east = [trial.submission_id for trial in planned if trial.station == "east"]
    submissions = []
    for _ in east:
        trial = take(database, "east")
        assert trial is not None
        assert take(database, "east") is None, "another agent of the station waits for this trial's end"
        with database.transaction() as session:
            ended = session.get_one(Trial, trial.id)
            submissions.append(ended.evaluation.submission_id)
            ended.state, ended.lease_expires_at, ended.finished_at = WorkState.CANCELLED, None, read_clock(session)
    assert submissions == east
    assert take(database, "east") is None, "the others are of another station"
    assert take(database, None) is None, "and an agent of neither station plays none"


def test_a_team_sees_its_own_trials_and_everybody_all_once_the_list_is_published(
    database: Database, teams: dict[str, Principal]
) -> None:
    with closed(database) as (session, stage):
        begin(session, CONSOLE, stage)
        own = list_trials(session, teams["Ants"], stage)
        assert len({trial.submission_id for trial in own}) == 1
        assert len(own) == STARTS
        assert list_trials(session, Principal(role=None), stage) == []
        for evaluation in session.scalars(select(Evaluation)):
            cancel(session, evaluation)
        reveal(session, CONSOLE, stage)
        assert len(list_trials(session, Principal(role=None), stage)) == STARTS * len(TEAMS)


def test_a_station_that_vanishes_for_an_hour_goes_on_where_it_was(
    database: Database, teams: dict[str, Principal]
) -> None:
    with closed(database) as (session, stage):
        begin(session, CONSOLE, stage)
    settings = make_settings(lease_s=0.001, lease_renewal_s=0.0001)  # as the database has started long ago
    taken, others = take(database, "east"), take(database, "west")
    assert taken is not None
    assert others is not None
    with database.transaction() as session:
        lost = session.get_one(Trial, taken.id)
        lost.lease_expires_at = read_clock(session) - timedelta(hours=1)
    with database.transaction() as session:
        swept = sweep(session, settings, give_up=lambda *_: pytest.fail("nothing is given up"))
        assert swept.queued_again == 1
    with database.transaction() as session:
        waiting = session.get_one(Trial, taken.id)
        assert (waiting.state, waiting.attempts, waiting.turn) == (WorkState.QUEUED, 0, taken.turn)
    again = take(database, "east")
    assert again is not None
    assert (again.id, again.token) == (taken.id, taken.token + 1)


def test_only_one_list_is_played_on_stations(database: Database, teams: dict[str, Principal]) -> None:
    with database.transaction() as session:
        assert len(session.scalars(select(Trial)).all()) == STARTS * len(teams)
        assert "" not in set(session.scalars(select(Trial.commitment)))


def test_a_plan_begins_once_its_stage_is_over_and_nothing_is_missing(
    database: Database, teams: dict[str, Principal]
) -> None:
    with database.transaction() as session:
        stage = Competition.read(session).stage(STATION, FIRST)
        with refused(ProblemCode.STAGE_NOT_OVER):
            begin(session, CONSOLE, stage)
        with refused(ProblemCode.FORBIDDEN):
            begin(session, teams["Ants"], stage)
    with closed(database) as (session, stage):
        stations.remove_station(session, CONSOLE, "west")
        with pytest.raises(ServiceError, match="vitac admin station add west"):
            begin(session, CONSOLE, stage)
        stations.add_station(session, CONSOLE, "west")
        begin(session, CONSOLE, stage)
        with pytest.raises(ServiceError, match="wait for a plan, got none"):
            begin(session, CONSOLE, stage)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sealed": None}, "sealed: at_once"),
        ({"list": "public", "sealed": None}, "list: public"),
        ({"plan": {"stations": []}}, "stations"),
        ({"plan": {"stations": ["east", "east"]}}, "two stations 'east'"),
    ],
)
def test_what_cannot_be_planned_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        CompetitionDefinition.model_validate(cup(**changes))


def test_a_simulated_track_has_no_plan() -> None:
    content = cup()
    content["tracks"] = {TRACK: content["tracks"][STATION]}
    with pytest.raises(DocumentRejected, match=r"vitac station track\), got peg-insertion"):
        require_known_tracks(CompetitionDefinition.model_validate(content), "cup.yaml")
